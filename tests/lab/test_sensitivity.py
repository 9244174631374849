"""Indices that are known, of Ishigami's function and of a power law; and the command: pictures and table."""

import csv
import json
import math

import numpy as np
import pytest
from distributed import LocalCluster
from SALib.test_functions import Ishigami

import knee_contact_ros
from knee_contact_ros.lab.sensitivity import SalibDesign, analyse, not_converged
from knee_contact_ros.lab.sensitivity_study import SensitivityStudy
from knee_contact_ros.lab.study_file import read_study
from knee_contact_ros.system.files import share_folder
from tests.helpers import commands
from tests.helpers.bags import raw_messages, write_rosbag2

CUBE = {name: [-math.pi, math.pi] for name in ("a", "b", "c")}
A, B = 7.0, 0.1
"""Constants of Ishigami's function, as SALib has them"""
EXPONENT = 1.5
RANGES = {
    "contact.stiffness": [5e7, 1e8],
    "contact.layer_depth": {"from": 2e-4, "to": 8e-4, "scale": "log"},
}
QUICK = {"fidelity.level": "quasi_static"}


def ishigami(design):
    """The function at the points of a design."""
    return np.asarray(Ishigami.evaluate(design.points(), A, B))


def test_morris_finds_what_bends_and_what_is_straight():
    design = SalibDesign(
        method="morris", n=40, ranges={"a": [0.0, 2.0], "b": [0.0, 1.0], "c": [0.0, 1.0]}
    )
    a, b, _ = design.points().T
    found = analyse(design, "peak_depth", 3.0 * a - 4.0 * b**2)
    sizes, means, deviations = map(found.final, ("mu_star", "mu", "sigma"))
    assert sizes["value"]["a"] == pytest.approx(6.0)  # over its whole range
    assert sizes["value"]["c"] == 0.0
    assert (
        sizes["low"]["b"] <= 4.0 <= sizes["high"]["b"]
    )  # the mean slope of a square over steps of 2/3, of 0 and 1/3
    assert deviations["value"]["a"] == pytest.approx(0.0, abs=1e-9)
    assert deviations["value"]["b"] > 0.5
    assert means["value"]["a"] > 0.0 > means["value"]["b"]


def mean_power(begin, end, power):
    """The mean of x^power, x evenly in the logarithm."""
    return (end**power - begin**power) / (power * math.log(end / begin))


def test_a_depth_at_rest_has_the_indices_of_its_power_law():
    """depth = (share L / K)^(1/n), a product of independent factors x^a, x evenly in the logarithm."""
    ends = {"contact.stiffness": (4e7, 1.2e8), "load.share": (0.4, 0.8)}
    ranges = {
        name: {"from": begin, "to": end, "scale": "log"} for name, (begin, end) in ends.items()
    }
    gait = {"time": [0.0, 0.01], "flexion_angle": [0.2, 0.2], "axial_load": [1500.0, 1500.0]}
    params = {
        "contact.law": "hertz",
        "contact.exponent": EXPONENT,
        "fidelity.level": "quasi_static",
    }
    found = knee_contact_ros.sensitivity(gait, ranges, params, n=512, outcomes=["peak_depth"])
    rows = found.cohort
    expected = (1500.0 * rows.values["load.share"] / rows.values["contact.stiffness"]) ** (
        1.0 / EXPONENT
    )
    assert rows.outcomes.peak_depth == pytest.approx(expected, abs=1e-6)  # the tolerance

    spread = {}
    for (name, (begin, end)), power in zip(
        ends.items(), (-1.0 / EXPONENT, 1.0 / EXPONENT), strict=True
    ):
        spread[name] = (
            mean_power(begin, end, 2.0 * power) / mean_power(begin, end, power) ** 2 - 1.0
        )
    whole = (1.0 + spread["contact.stiffness"]) * (1.0 + spread["load.share"]) - 1.0
    alone = found.outcomes["peak_depth"].final("S1").loc["contact.stiffness"]
    assert alone["low"] <= spread["contact.stiffness"] / whole <= alone["high"]
    assert list(found.to_pandas().columns) == [
        "outcome",
        "parameter",
        "index",
        "n",
        "value",
        "low",
        "high",
    ]


def test_failed_cases_constant_outcomes_and_noise_have_no_index():
    design = SalibDesign(n=256, ranges=CUBE)
    values = ishigami(design)
    values[[0, 1, 7 * design.group]] = np.nan  # of two groups
    found = analyse(design, "peak_depth", values)
    assert (found.cases, found.spoilt, found.reason) == (3, 2, "")
    assert set(found.final("ST")["n"]) == {254}
    spoilt = values.copy()
    spoilt[: 30 * design.group : design.group] = np.nan
    noise = 3.0 + 1e-9 * np.random.default_rng(0).standard_normal(design.number)
    for given, bound, reason in (
        (spoilt, 0.0, "31 of 1280 cases have no value and spoil 30 of 256 groups"),
        (np.full(design.number, np.nan), 0.0, "no case has a value"),
        (np.zeros(design.number), 0.0, "the same in all cases"),
        (noise, 1e-6, "its numerical error bound is 1e-06 m"),
    ):
        refused = analyse(design, "peak_depth", given, bound)
        assert refused.table.empty
        assert reason in refused.reason


def test_indices_that_have_not_converged_are_reported():
    design = SalibDesign(n=16, ranges=CUBE)
    doubts = not_converged(design, analyse(design, "peak_depth", ishigami(design)))
    assert "not converged: the interval of the largest index" in doubts[0]
    assert "may do" in doubts[0]
    noisy = analyse(design, "peak_depth", ishigami(design), 0.5 * float(ishigami(design).std()))
    assert (
        "the numerical error bound is 50% of the standard deviation"
        in not_converged(design, noisy)[-1]
    )
    design = SalibDesign(n=4096, ranges={"a": [0.0, 1.0], "b": [0.0, 0.3]})
    assert not not_converged(design, analyse(design, "peak_depth", design.points() @ [1.0, 1.0]))


@pytest.fixture(scope="module")
def scheduler():
    """Workers in this process, to save their start."""
    with LocalCluster(
        n_workers=1,
        threads_per_worker=1,
        processes=False,
        protocol="tcp",
        host="127.0.0.1",
        dashboard_address="127.0.0.1:0",
        scheduler_kwargs={"dashboard": False},
    ) as cluster:
        yield cluster.scheduler_address


@pytest.fixture(scope="module")
def short_bag(tmp_path_factory, right_bag):
    """Three tenths of a second of the shipped gait, in stance."""
    return write_rosbag2(tmp_path_factory.mktemp("bag") / "short", raw_messages(right_bag)[60:90])


def study_with(**sensitivity):
    """What a file says of the analysis."""
    return {"sensitivity": {"n": 8, "ranges": RANGES} | sensitivity}


def run(folder, bag, content, scheduler, more=""):
    """The command on a study, into `folder / out`."""
    usual = {
        "bags": [str(bag)],
        "params": ["osteoarthritis"],
        "values": QUICK,
        "outcomes": ["peak_depth"],
    }
    (folder / "study.yaml").write_text(json.dumps(usual | content))
    options = f"--output {folder}/out --scheduler {scheduler} {more}"
    return commands.run(f"sensitivity {folder}/study.yaml {options}")


def rows(folder):
    """The table of a study."""
    with (folder / "out" / "indices.csv").open() as file:
        return list(csv.DictReader(file))


def test_a_study_gives_pictures_and_a_tidy_table(tmp_path, short_bag, scheduler, capsys):
    content = study_with(n=16, second_order=True) | {"grid": {"load.share": [0.4, 1.0]}}
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "sensitivity_peak_force.png").write_bytes(b"earlier")
    assert run(tmp_path, short_bag, content, scheduler) == 0
    printed = capsys.readouterr()
    # Of two parameters, A with b is B with a
    assert (
        "192 cases: 128 computed, 0 were there already, 64 the same as others, 0 failed"
        in printed.out
    )
    assert "peak depth, load.share 0.4: contact.layer_depth" in printed.out
    assert "warning: peak depth, load.share 0.4: not converged" in printed.err
    names = {path.name for path in (tmp_path / "out").iterdir()}
    assert names == {"cases", "indices.csv", "sensitivity_peak_depth.png"}
    found = rows(tmp_path)
    columns = "bag, params, load.share, outcome, parameter, index, n, value, low, high"
    assert ", ".join(found[0]) == columns
    for name, values in (
        ("load.share", {"0.4", "1.0"}),
        ("index", {"S1", "ST", "S2"}),
        ("n", {"16"}),
    ):
        assert {row[name] for row in found} == values
    assert all(float(row["low"]) <= float(row["value"]) <= float(row["high"]) for row in found)
    assert run(tmp_path, short_bag, content | study_with(n=32, second_order=True), scheduler) == 0
    assert (
        "384 cases: 128 computed, 128 were there already, 128 the same" in capsys.readouterr().out
    )
    morris = content | study_with(method="morris")
    assert run(tmp_path, short_bag, morris, scheduler, "--figures svg") == 0
    names = {path.name for path in (tmp_path / "out").iterdir()}
    assert names == {"cases", "indices.csv", "sensitivity_peak_depth.svg"}
    assert {row["index"] for row in rows(tmp_path)} == {"mu_star", "mu", "sigma"}


def test_failed_cases_are_reported_and_too_many_leave_no_index(
    tmp_path, short_bag, scheduler, capsys
):
    ranges = {"contact.femoral_radius": [0.03, 0.06], "contact.tibial_radius": [0.05, 0.09]}
    content = study_with(ranges=ranges) | {
        "values": QUICK | {"contact.stiffness_from": "material"}
    }
    assert run(tmp_path, short_bag, content, scheduler) == 1
    printed = capsys.readouterr()
    assert " failed" in printed.out
    assert "cases have no value and spoil" in printed.out
    assert "so the rest is not a sample of the ranges" in " ".join(printed.out.split())
    assert "failed: parameter contact.tibial_radius" in " ".join(printed.err.split())
    assert rows(tmp_path) == []
    assert not list((tmp_path / "out").glob("*.png"))


def test_the_example_can_be_read():
    found = read_study(share_folder() / "examples" / "sensitivity.yaml", SensitivityStudy)
    assert found.number == 4 * found.design.n * 8


def with_range(name, ends):
    """A further range."""
    return study_with(ranges=RANGES | {name: ends})


@pytest.mark.parametrize(
    ("wrong", "line"),
    [
        (
            study_with(n=100),
            "sensitivity.n: 100 is not allowed; with method sobol a power of two, 64 or 128",
        ),
        (
            study_with(method="morris", second_order=True),
            "second_order: True is not allowed; it is of method sobol",
        ),
        (study_with(ranges={"load.share": [0.4, 0.8]}), "sensitivity.ranges: {'load.share'"),
        (with_range("load.share", [0.9, 0.4]), "is not allowed; from < to is required"),
        (
            with_range("fidelity.budget", [0, 9]),
            "fidelity.budget: a range is not allowed; only a real number can have one",
        ),
        (study_with() | {"sample": {"n": 8}}, "is not allowed; sensitivity draws its own points"),
        (
            study_with() | {"outcomes": ["peak_death"]},
            "['peak_death'] is not allowed; some of peak_force, peak_depth",
        ),
    ],
)
def test_bad_input_is_one_line(tmp_path, short_bag, wrong, line, capsys):
    assert run(tmp_path, short_bag, wrong, "tcp://127.0.0.1:9") == 2
    error = capsys.readouterr().err
    assert line in error
    assert error.count("\n") == 1
    assert not list((tmp_path / "out").glob("*"))
