"""`knee-contact sweep`: what it says, and bad input: one line, code 2, nothing half-written."""

from __future__ import annotations

import re
import socket
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
Capture = pytest.CaptureFixture[str]


@pytest.fixture(autouse=True)
def sources(monkeypatch: pytest.MonkeyPatch) -> None:
    """Names are as from the project's folder."""
    monkeypatch.chdir(ROOT)


@pytest.fixture
def study(tmp_path: Path, right_bag: Path) -> Path:
    """A study file."""
    path = tmp_path / "study.yaml"
    path.write_text(f"bags: [{right_bag}]\n{GRID}\n")
    return path


def sweep(study: Path | str, out: Path | str, address: str) -> list[str]:
    """The arguments of the command."""
    return ["sweep", str(study), "--output", str(out), "--scheduler", address]


def refused(arguments: list[str], capfd: Capture) -> str:
    """What a command says that ends with code 2."""
    assert main(arguments) == 2
    said, errors = capfd.readouterr()
    assert said == ""
    assert re.fullmatch(r"knee-contact: [^\n]+\n", errors)
    return errors


def test_it_says_what_there_is_also_if_the_folder_cannot_be_written_any_more(
    address: str, study: Path, small_disk: Path, capfd: Capture
) -> None:
    for told in ("2 computed, 0 were there", "0 computed, 2 were there"):
        assert main(sweep(study, small_disk, address)) == 0
        assert capfd.readouterr() == (f"2 cases: {told}, 0 failed\ntable: {small_disk} (pandas.read_parquet)\n", "")
        remount(small_disk, "ro")
    assert len(table(small_disk)) == 2


BAD = {
    "bag nobody.mcap: No such file or directory": "bags: [nobody.mcap]",
    "bag file:///nobody.mcap: cannot be fetched": "bags: ['file:///nobody.mcap']",
    "bag nothing://a: cannot be fetched: Protocol not known: nothing": "bags: ['nothing://a']",
    "it must map bags, params, grid or sample": "- a",
    "parameter femur.profile: cannot read nobody.csv": "bags: [{bag}]\nparams: [mri_femur]\nvalues: "
    "{{femur.profile: nobody.csv}}",
}


@pytest.mark.parametrize("said", BAD)
def test_bad_studies(said: str, address: str, right_bag: Path, study: Path, capfd: Capture) -> None:
    study.write_text(BAD[said].format(bag=right_bag))
    assert said in refused(sweep(study, study.parent / "out", address), capfd)
    assert list(study.parent.iterdir()) == [study]


def test_a_scheduler_that_cannot_be_reached(study: Path, capfd: Capture, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(run_study, "PATIENCE", 1.0)
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))  # not listening
        for address in (f"tcp://127.0.0.1:{taken.getsockname()[1]}", "nonsense", "gopher://a:1", "tcp://127.0.0.1"):
            said = refused(sweep(study, study.parent / "out", address), capfd)
            assert f"scheduler {address}: cannot be reached" in said
    assert list(study.parent.iterdir()) == [study]


def test_a_folder_that_cannot_be_written(address: str, study: Path, small_disk: Path, capfd: Capture) -> None:
    remount(small_disk, "ro")
    for out in (small_disk, small_disk / "out"):
        assert f"output {out}: Read-only file system" in refused(sweep(study, out, address), capfd)
    assert "Not a directory" in refused(sweep(study, study / "out", address), capfd)


@pytest.mark.parametrize("library", ["pyarrow", "distributed", "fsspec"])
def test_a_missing_extra_is_named(library: str, study: Path, capfd: Capture, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(files, "find_spec", lambda name: None if name == library else name)
    said = refused(["sweep", str(study), "--output", "out"], capfd)
    assert f"{library} is not installed; " in said
    assert "[sweep]" in said


def test_the_example_of_the_page_runs(address: str, study: Path, tmp_path: Path, capfd: Capture) -> None:
    example = re.search(
        r"```yaml\n(.*?)```", (ROOT / "docs" / "how-to" / "many-knees.md").read_text(encoding="utf-8"), re.DOTALL
    )
    assert example
    study.write_text(example[1])
    assert main(sweep(study, tmp_path / "out", address)) == 0
    told = re.match(r"(\d+) cases: \1 computed, 0 were there, 0 failed", capfd.readouterr().out)
    assert told
    assert len(table(tmp_path / "out")) == int(told[1])
