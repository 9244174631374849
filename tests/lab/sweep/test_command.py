"""`knee-contact sweep`: what it says, and bad input: one line, code 2, nothing half-written."""

from __future__ import annotations

import re
import socket
from collections.abc import Iterator
from pathlib import Path

import pytest

from knee_contact_ros.commands.main import main
from knee_contact_ros.lab import run_study
from knee_contact_ros.system import files
from tests import ROOT
from tests.helpers.disks import remount
from tests.lab.sweep.studies import table

pytestmark = pytest.mark.xdist_group("cluster of cohorts")
GRID = "grid: {contact.damping: [1.0e3, 2.0e3]}"


@pytest.fixture(autouse=True)
def sources(monkeypatch: pytest.MonkeyPatch) -> None:
    """Names are as from the project's folder."""
    monkeypatch.chdir(ROOT)


def saved(folder: Path, text: str) -> str:
    """A study file."""
    path = folder / "study.yaml"
    path.write_text(text)
    return str(path)


def test_it_says_what_there_is_and_where(
    address: str, right_bag: Path, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    study, out = saved(tmp_path, f"bags: [{right_bag}]\n{GRID}\n"), tmp_path / "out"
    asked = ["sweep", study, "--output", str(out), "--scheduler", address]
    for told in ("2 computed, 0 were there", "0 computed, 2 were there"):
        assert main(asked) == 0
        said, errors = capfd.readouterr()
        assert said == f"2 cases: {told}, 0 failed\ntable: {out} (pandas.read_parquet)\n"
        assert errors == ""


BAD = {
    "unknown parameter contact.dampin; did you mean contact.damping?": "bags: [{bag}]\ngrid: {{contact.dampin: [1.0]}}",
    "contact.damping: [] is not allowed; a list of values": "bags: [{bag}]\ngrid: {{contact.damping: []}}",
    "bag nobody.mcap: No such file or directory": "bags: [nobody.mcap]\n" + GRID.replace("{", "{{").replace("}", "}}"),
    "bag file:///nobody.mcap: cannot be fetched": "bags: ['file:///nobody.mcap']",
    "bag nothing://a: cannot be fetched: Protocol not known: nothing": "bags: ['nothing://a']",
    "bags: [] is not allowed": "bags: []",
    "it must map bags, params, grid or sample": "- a",
    "nobody.yaml: cannot read the parameter file": "bags: [{bag}]\nparams: [nobody.yaml]",
    "parameter femur.profile: cannot read nobody.csv": "bags: [{bag}]\nparams: [mri_femur]\nvalues: "
    "{{femur.profile: nobody.csv}}",
}


def refused(arguments: list[str], capfd: pytest.CaptureFixture[str]) -> str:
    """What a command says that ends with code 2."""
    assert main(arguments) == 2
    said, errors = capfd.readouterr()
    assert said == ""
    assert re.fullmatch(r"knee-contact: [^\n]+\n", errors)
    return errors


@pytest.mark.parametrize("said", BAD)
def test_bad_studies(
    said: str, address: str, right_bag: Path, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    study = saved(tmp_path, BAD[said].format(bag=right_bag))
    asked = ["sweep", study, "--output", str(tmp_path / "out"), "--scheduler", address]
    assert said in refused(asked, capfd)
    assert [path.name for path in tmp_path.iterdir()] == ["study.yaml"]


def test_a_bag_that_is_none(address: str, tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "none.mcap").write_text("no bag")
    study = saved(tmp_path, f"bags: [{tmp_path}/none.mcap]\n{GRID}\n")
    said = refused(["sweep", study, "--output", str(tmp_path / "out"), "--scheduler", address], capfd)
    assert "none.mcap" in said
    assert list((tmp_path / "out").glob("cases-*")) == []


@pytest.fixture
def nobody() -> Iterator[str]:
    """An address at which nobody answers."""
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))  # not listening
        yield f"tcp://127.0.0.1:{taken.getsockname()[1]}"


def test_a_scheduler_that_cannot_be_reached(
    nobody: str, right_bag: Path, tmp_path: Path, capfd: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(run_study, "PATIENCE", 1.0)
    study = saved(tmp_path, f"bags: [{right_bag}]\n{GRID}\n")
    for address in (nobody, "nonsense", "gopher://a:1", "tcp://127.0.0.1"):
        said = refused(["sweep", study, "--output", str(tmp_path / "out"), "--scheduler", address], capfd)
        assert f"scheduler {address}: cannot be reached" in said
        assert not (tmp_path / "out").exists()


def test_a_folder_that_cannot_be_written(
    address: str, right_bag: Path, tmp_path: Path, small_disk: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    study = saved(tmp_path, f"bags: [{right_bag}]\n{GRID}\n")
    remount(small_disk, "ro")
    for out in (small_disk, small_disk / "out"):
        said = refused(["sweep", study, "--output", str(out), "--scheduler", address], capfd)
        assert f"output {out}: Read-only file system" in said
    (tmp_path / "file").touch()
    said = refused(["sweep", study, "--output", str(tmp_path / "file" / "out"), "--scheduler", address], capfd)
    assert "Not a directory" in said


def test_a_full_read_only_table_may_still_be_asked_for(
    address: str, right_bag: Path, tmp_path: Path, small_disk: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    study = saved(tmp_path, f"bags: [{right_bag}]\n{GRID}\n")
    asked = ["sweep", study, "--output", str(small_disk), "--scheduler", address]
    assert main(asked) == 0
    remount(small_disk, "ro")
    capfd.readouterr()
    assert main(asked) == 0
    assert "0 computed, 2 were there" in capfd.readouterr().out
    assert len(table(small_disk)) == 2


@pytest.mark.parametrize("library", ["pyarrow", "distributed", "fsspec"])
def test_a_missing_extra_is_named(
    library: str, tmp_path: Path, capfd: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(files, "find_spec", lambda name: None if name == library else name)
    said = refused(["sweep", "study.yaml", "--output", str(tmp_path / "out")], capfd)
    assert f"{library} is not installed; " in said
    assert "[sweep]" in said


@pytest.mark.parametrize("options", [[], ["--output", "out", "--workers", "0"], ["--output", "", "--workers", "1"]])
def test_bad_options(options: list[str], right_bag: Path, tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    refused(["sweep", saved(tmp_path, f"bags: [{right_bag}]\n{GRID}\n"), *options], capfd)
    assert [path.name for path in tmp_path.iterdir()] == ["study.yaml"]


def test_the_example_of_the_page_runs(address: str, tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    page = (ROOT / "docs" / "cohorts.md").read_text(encoding="utf-8")
    example = re.search(r"```yaml\n(.*?)```", page, re.DOTALL)
    assert example
    study = saved(tmp_path, example[1])
    assert main(["sweep", study, "--output", str(tmp_path / "out"), "--scheduler", address]) == 0
    told = re.match(r"(\d+) cases: \1 computed, 0 were there, 0 failed", capfd.readouterr().out)
    assert told
    assert len(table(tmp_path / "out")) == int(told[1])
