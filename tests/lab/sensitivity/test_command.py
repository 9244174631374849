"""The command: page, pictures and table of a small study, going on after a stop, and bad input in one line."""

from __future__ import annotations

import csv
import json
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from distributed import LocalCluster

from knee_contact_ros.commands.main import main
from knee_contact_ros.lab import run_study
from knee_contact_ros.lab.run_study import Report
from knee_contact_ros.lab.sensitivity import read_sensitivity_study
from knee_contact_ros.system.files import share_folder
from tests.helpers.bags import write_rosbag2
from tests.helpers.messages import raw_inputs

RANGES = {"contact.stiffness": [5e7, 1e8], "contact.layer_depth": {"from": 2e-4, "to": 8e-4, "scale": "log"}}
QUICK = {"fidelity.level": "quasi_static"}


@pytest.fixture(scope="module")
def scheduler() -> Iterator[str]:
    """Workers in this process, to save their start."""
    with LocalCluster(n_workers=1, threads_per_worker=1, processes=False, protocol="tcp", host="127.0.0.1",
                      dashboard_address="127.0.0.1:0", scheduler_kwargs={"dashboard": False}) as cluster:  # fmt: skip
        yield cluster.scheduler_address


@pytest.fixture(scope="module")
def short_bag(tmp_path_factory: pytest.TempPathFactory, right_bag: Path) -> Path:
    """Three tenths of a second of the shipped gait, in stance."""
    return write_rosbag2(tmp_path_factory.mktemp("bag") / "short", raw_inputs(right_bag)[60:90])


def study(bag: Path, **sensitivity: Any) -> dict[str, Any]:
    """What a file says."""
    return {
        "bags": [str(bag)],
        "params": ["osteoarthritis"],
        "values": QUICK,
        "outcomes": ["peak_depth"],
        "sensitivity": {"n": 8, "ranges": RANGES} | sensitivity,
    }


def asked(**sensitivity: Any) -> dict[str, Any]:
    """What a file says otherwise of the analysis."""
    return {"sensitivity": {"n": 8, "ranges": RANGES} | sensitivity}


def also(name: str, told: Any) -> dict[str, Any]:
    """A further range."""
    return asked(ranges=RANGES | {name: told})


def run(folder: Path, content: dict[str, Any], scheduler: str) -> int:
    """The command on a study, into `folder / out`."""
    (folder / "study.yaml").write_text(json.dumps(content))
    return main(
        ["sensitivity", str(folder / "study.yaml"), "--output", str(folder / "out"), "--scheduler", scheduler]
    )  # fmt: skip


def rows(folder: Path) -> list[dict[str, str]]:
    with (folder / "out" / "indices.csv").open() as file:
        return list(csv.DictReader(file))


def test_a_study_gives_a_page_with_pictures_and_a_tidy_table(
    tmp_path: Path, short_bag: Path, scheduler: str, capsys: pytest.CaptureFixture[str]
) -> None:
    content = study(short_bag, n=16, second_order=True) | {"grid": {"load.share": [0.4, 1.0]}}
    assert run(tmp_path, content, scheduler) == 0
    told = capsys.readouterr()
    assert "192 cases: 128 computed, 64 were there, 0 failed" in told.out  # of two parameters, A with b is B with a
    assert "peak depth, load.share 0.4: contact.layer_depth" in told.out
    assert "warning: peak depth, load.share 0.4: not converged" in told.err
    names = {path.name for path in (tmp_path / "out").iterdir()}
    assert {"cases", "indices.csv", "sensitivity.html", "bars_peak_depth.png", "convergence_peak_depth.png"} <= names
    assert not any(name.startswith("_") for name in names)
    page = (tmp_path / "out" / "sensitivity.html").read_text()
    assert "192 knees computed" in page
    assert "not converged: the interval of the largest index" in page
    found = rows(tmp_path)
    assert list(found[0]) == [
        "bag",
        "params",
        "load.share",
        "outcome",
        "parameter",
        "index",
        "n",
        "value",
        "low",
        "high",
    ]
    assert {row["load.share"] for row in found} == {"0.4", "1.0"}
    assert {row["index"] for row in found} == {"S1", "ST", "S2"}
    assert {row["n"] for row in found} == {"8", "16"}
    assert all(float(row["low"]) <= float(row["value"]) <= float(row["high"]) for row in found)


def test_a_larger_n_and_a_stopped_run_compute_only_what_is_missing(
    tmp_path: Path, short_bag: Path, scheduler: str, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    assert run(tmp_path, study(short_bag), scheduler) == 0
    assert "32 cases: 32 computed" in capsys.readouterr().out
    assert run(tmp_path, study(short_bag, n=16), scheduler) == 0
    assert "64 cases: 32 computed, 32 were there" in capsys.readouterr().out
    at_once = (tmp_path / "out" / "indices.csv").read_bytes()

    shutil.rmtree(tmp_path / "out")
    finished = run_study.computed

    def stopped(*asked: Any) -> Iterator[Report]:
        for number, one in enumerate(finished(*asked)):
            if number == 3:
                raise KeyboardInterrupt
            yield one

    monkeypatch.setattr(run_study, "computed", stopped)
    assert run(tmp_path, study(short_bag, n=16), scheduler) == 130
    assert not (tmp_path / "out" / "indices.csv").exists()
    monkeypatch.setattr(run_study, "computed", finished)
    capsys.readouterr()
    assert run(tmp_path, study(short_bag, n=16), scheduler) == 0
    computed = int(capsys.readouterr().out.split(" cases: ")[1].split(" computed")[0])
    assert 0 < computed < 64
    assert (tmp_path / "out" / "indices.csv").read_bytes() == at_once


def test_morris_has_a_plane_and_takes_away_pictures_of_an_earlier_run(
    tmp_path: Path, short_bag: Path, scheduler: str
) -> None:
    content = study(short_bag, method="morris", n=8)
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "bars_peak_force.png").write_bytes(b"earlier")
    assert run(tmp_path, content, scheduler) == 0
    pictures = {path.name for path in (tmp_path / "out").glob("*.png")}
    assert pictures == {"bars_peak_depth.png", "plane_peak_depth.png"}  # of n/2 there are too few for a course
    assert {row["index"] for row in rows(tmp_path)} == {"mu_star", "mu", "sigma"}


def test_cases_that_fail_are_told_and_too_many_leave_no_index(
    tmp_path: Path, short_bag: Path, scheduler: str, capsys: pytest.CaptureFixture[str]
) -> None:
    ranges = {"contact.femoral_radius": [0.03, 0.06], "contact.tibial_radius": [0.05, 0.09]}
    content = study(short_bag, ranges=ranges) | {"values": QUICK | {"contact.stiffness_from": "material"}}
    assert run(tmp_path, content, scheduler) == 0
    told = capsys.readouterr()
    assert " failed" in told.out
    assert "cases have no value and spoil" in told.out
    assert "cases failed: parameter contact.tibial_radius" in told.err
    assert rows(tmp_path) == []
    assert "so what is left is no sample of the ranges" in (tmp_path / "out" / "sensitivity.html").read_text()


def test_the_example_can_be_read() -> None:
    found = read_sensitivity_study(share_folder() / "examples" / "sensitivity.yaml")
    assert found.cases.number == 4 * found.design.n * 8


@pytest.mark.parametrize(
    ("wrong", "line"),
    [
        (asked(n=100), "sensitivity.n: 100 is not allowed with method sobol; a power of two, 64 or 128"),
        (asked(n=4), "sensitivity.n: 4 is not allowed; it should be greater than or equal to 8"),
        (asked(method="fast"), "sensitivity.method: 'fast' is not allowed"),
        (asked(method="morris", second_order=True), "second_order: True is not allowed with method morris"),
        (asked(confidence=2), "sensitivity.confidence: 2 is not allowed"),
        (asked(ranges={"load.share": [0.4, 0.8]}), "sensitivity.ranges: {'load.share': [0.4, 0.8]} is not allowed"),
        (also("contact.stifness", [1.0, 2.0]), "did you mean contact.stiffness?"),
        (also("load.share", [0.9, 0.4]), "load.share: {'from': 0.9, 'to': 0.4} is not allowed; from 0.9"),
        (also("load.share", [0.4, 1.4]), "load.share: 1.4 is not allowed"),
        (also("load.share", 0.4), "load.share: 0.4 is not allowed; a list of two numbers, or from, to and scale"),
        (also("fidelity.budget", [0, 9]), "fidelity.budget: a range is not allowed; it is no real number"),
        ({"sensitivity": None}, "sensitivity: None is not allowed; method, n and ranges"),
        ({"sample": {"n": 8, "ranges": RANGES}}, "sample is not allowed; the method under sensitivity draws its own"),
        ({"outcomes": ["peak_death"]}, "outcomes: peak_death is not allowed; one of peak_force, peak_depth"),
        ({"outcomes": []}, "outcomes: [] is not allowed; a list of some of"),
        ({"grid": {"contact.stiffness": [5e7]}}, "contact.stiffness is given twice"),
        ({"bags": ["nowhere.mcap"]}, "bag nowhere.mcap: No such file or directory"),
    ],
)  # fmt: skip
def test_bad_input_is_one_line(
    tmp_path: Path, short_bag: Path, wrong: dict[str, Any], line: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run(tmp_path, study(short_bag) | wrong, "tcp://127.0.0.1:9") == 2
    told = capsys.readouterr().err
    assert line in told
    assert told.count("\n") == 1
    assert not list((tmp_path / "out").glob("*.html"))
