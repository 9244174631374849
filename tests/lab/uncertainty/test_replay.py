"""A recording is answered again, with the same bits where nothing is off."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from knee_contact_ros.bags.provenance import Change, read_provenance
from knee_contact_ros.lab import uncertainty
from knee_contact_ros.lab.uncertainty import Deviation, Given, given_in
from knee_contact_ros.model.types import FLAT, Rows, Status
from knee_contact_ros.offline.solve import solve
from knee_contact_ros.parameters.files import load_parameters
from knee_contact_ros.streams.contact_stream import Compartment
from knee_contact_ros.system.errors import UsageError
from tests.helpers.bags import write_rosbag2
from tests.helpers.messages import raw_inputs
from tests.offline.test_solve import make_bag, silent

KNEES: dict[str, Any] = {
    "healthy": "healthy",
    "two layers": "osteoarthritis",
    "both compartments": ["healthy", "both_compartments"],
    "measured share": {"load.compartment": "measured_share"},
    "moment balance": {"load.compartment": "moment_balance", "load.compartment_spacing": 0.2},
    "all of the load": {"load.compartment": "total"},
}
SHORT = 60
"""Ticks: plain Python computes them"""


def given(bag: Path, source: Any) -> Given:
    return given_in(bag, load_parameters(source), silent, replays=1, compiled=False)


def assert_same(one: Rows, other: Rows) -> None:
    """In all but the status, of which the pairing has told its part."""
    for name in FLAT.names or ():
        if name != "status":
            np.testing.assert_array_equal(one.view(FLAT)[name], other.view(FLAT)[name], err_msg=name)


@pytest.fixture(scope="module")
def short_bag(right_bag: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_rosbag2(tmp_path_factory.mktemp("short") / "bag", raw_inputs(right_bag)[: 2 * SHORT])


@pytest.mark.parametrize("knee", KNEES)
def test_off_by_nothing_are_the_bits_of_solve(knee: str, short_bag: Path) -> None:
    taken = given(short_bag, KNEES[knee])
    assert len(taken.axial) == len(taken.rows[0]) >= SHORT - 1
    for again, rows in zip(taken.answers({}), taken.rows, strict=True):
        assert_same(again, rows)


def test_a_run_that_began_anew_begins_anew(tmp_path: Path) -> None:
    rows = [(i * 5_000_000, 0.1 + 0.02 * i, 800.0 + 200.0 * i) for i in range(40)]
    once = raw_inputs(make_bag(tmp_path / "once.mcap", rows))
    later = [message._replace(log_time=message.log_time + 1_000_000_000) for message in once]
    taken = given(write_rosbag2(tmp_path / "twice", [*once, *later]), {"contact.law": "kelvin_voigt"})
    assert np.flatnonzero(taken.rows[0]["status"] & Status.TIME_RESET).tolist() == [40]
    assert_same(taken.answers({})[0], taken.rows[0])


@pytest.mark.parametrize(("asked", "compiled"), [(None, [False, True]), (True, [True, True]), (False, [False, False])])
def test_many_more_answers_are_compiled_though_a_few_are_not(
    asked: bool | None, compiled: list[bool], short_bag: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    made: list[Compartment] = []

    def noted(compartment: Compartment) -> None:
        made.append(compartment)

    monkeypatch.setattr(Compartment, "compile", noted)
    monkeypatch.setattr(uncertainty, "worth_compiling", lambda ticks: ticks > 100 * SHORT)
    few = given_in(short_bag, load_parameters("healthy"), silent, replays=2, compiled=asked)
    many = few.ready_for(200)
    assert [few.compiled, many.compiled] == compiled
    assert sum(one in many.compartments for one in made) == any(compiled)  # once
    assert_same(many.answers({})[0], few.rows[0])


def test_heights_are_moved_where_they_are_prescribed(tmp_path: Path) -> None:
    rows = [(i * 5_000_000, 0.1, 800.0) for i in range(10)]
    taken = given(make_bag(tmp_path / "in.mcap", rows, heights=[0.0335] * 10), {"drive": "displacement"})
    assert_same(taken.answers({})[0], taken.rows[0])
    (higher,) = taken.answers({Deviation("femoral_height", 1e-4, relative=False): 1.0})
    # the depth of a circle on a plane is the radius less the height: three roundings of 0.03 m
    assert higher["penetration_depth"] == pytest.approx(taken.rows[0]["penetration_depth"] - 1e-4, abs=3e-17)


def test_inputs_are_off_where_they_come_in(short_bag: Path) -> None:
    taken = given(short_bag, ["healthy", "both_compartments"])
    medial, lateral = taken.rows
    off = {
        Deviation("axial_load", 10.0, relative=False): 2.0,
        Deviation("medial_share", 0.1, relative=False): 1.0,
        Deviation("flexion_angle", 0.01, relative=False): -1.0,
    }
    more, less = taken.answers(off)
    axial = medial["load"] + lateral["load"] + 20.0
    assert more["load"] == pytest.approx(0.6 * axial, rel=1e-14)  # a few roundings
    assert less["load"] == pytest.approx(0.4 * axial, rel=1e-14)
    np.testing.assert_array_equal(more["flexion_angle"], medial["flexion_angle"] - 0.01)


def test_a_lateral_constant_that_follows_is_off_too(short_bag: Path) -> None:
    taken = given(short_bag, ["healthy", "both_compartments"])
    softer = {Deviation("contact.stiffness", 0.5, relative=True): -1.0}
    assert all((now["penetration_depth"].max() > rows["penetration_depth"].max())
               for now, rows in zip(taken.answers(softer), taken.rows, strict=True))  # fmt: skip
    alone = {Deviation("lateral.contact.stiffness", 0.5, relative=True): -1.0}
    medial, lateral = taken.answers(alone)
    assert_same(medial, taken.rows[0])
    assert lateral["penetration_depth"].max() > taken.rows[1]["penetration_depth"].max()


def test_a_recording_whose_parameters_changed_is_refused(short_bag: Path, tmp_path: Path) -> None:
    out = tmp_path / "out.mcap"
    solve(short_bag, load_parameters("healthy"), out, silent)
    provenance = read_provenance(out)
    assert provenance is not None
    taken = given_in(out, provenance, silent, replays=0, compiled=False)
    assert_same(taken.answers({})[0], taken.rows[0])
    with pytest.raises(UsageError, match="its parameters changed, or the model was reset"):
        given_in(out, provenance._replace(changes=(Change(3, None),)), silent, replays=0)
