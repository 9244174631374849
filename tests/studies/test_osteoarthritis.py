"""A small version of the study of arthritic knees, and what it says."""

from __future__ import annotations

import csv

import numpy as np
import pytest

pytest.importorskip("tabulate", reason="the studies' tables")

from studies.osteoarthritis import findings as checks
from studies.osteoarthritis.findings import count
from studies.osteoarthritis.knees import (
    CHOSEN,
    FIRST,
    HEADER,
    LAYER,
    SECOND,
    SHIPPED,
    STUDY,
    TOLERANCE,
    Grid,
    Knees,
    along,
    compute,
    equal_second,
    needed_depth,
    ratio,
    rest_force,
    turning,
    whole,
)
from studies.osteoarthritis.page import SHIPPED_KNEE
from tests import ROOT

PAGE = ROOT / "docs" / "osteoarthritis-study.md"
SHIPPED_CELL, SOFT_CELL, THICK_CELL = (0, 0, 1), (0, 0, 0), (0, 1, 1)
SMALL = Grid(np.array([0.5]), np.array([SHIPPED.layer_depth, 3e-3]), np.array([FIRST, SHIPPED.stiffness_2]))
RINGING = 2e-3
"""Of the impulse: what the undamped first layer's ringing makes of it, read every 5 ms (0.11 % of 5000 knees)"""
FOUR_DIGITS = 1e-4
DASHPOT = 1e-3
"""What the dashpot does to a peak on a prescribed path"""


@pytest.fixture(scope="module", autouse=True)
def quickly():
    with pytest.MonkeyPatch.context() as patch:
        patch.setitem(TOLERANCE, "fidelity.tolerance", 1e-6)
        patch.setattr(checks, "COMPILED", None)
        yield


@pytest.fixture(scope="module")
def knees(quickly: None) -> Knees:
    return compute(SMALL)


def test_under_the_load_the_force_is_the_loads(knees: Knees) -> None:
    time, load = knees.paths[0].stamp * 1e-9, knees.paths[0].load
    given = float(np.sum(0.5 * (load[1:] + load[:-1]) * np.diff(time)))
    assert knees.forced.impulse == pytest.approx(given, rel=RINGING)
    forced = ratio(knees, knees.forced)
    assert forced.min() > 1.0 - 2e-3  # 0.2 % of 5000 knees
    assert count(forced).drops == 0
    assert knees.forced.peak_depth[SHIPPED_CELL] < knees.healthy.peak_depth[0] < knees.forced.peak_depth[SOFT_CELL]


def test_momentum_is_what_the_impulses_differ_by(knees: Knees) -> None:
    recorded = checks.momentum(knees, SHIPPED_CELL, 5e-3)
    finer = checks.momentum(knees, SHIPPED_CELL, 1e-3)
    assert recorded.load == pytest.approx(finer.load)
    assert abs(finer.excess - finer.gained) < 1e-4 * finer.load  # trapezoids of 1 ms over a ringing of 10 ms


def test_on_the_healthy_path_bone_presses_more_and_what_is_soft_less(knees: Knees) -> None:
    led, depth = ratio(knees, knees.led), float(knees.healthy.peak_depth[0])
    assert led[SHIPPED_CELL] == pytest.approx(8.02, abs=0.01)  # the reproduction has 8.01, on the fitted curve
    assert led[SOFT_CELL] < 0.75
    assert led[THICK_CELL] == pytest.approx(1.0, abs=DASHPOT)
    assert (np.diff(knees.led.peak_force, axis=2) >= 0.0).all()
    equal = equal_second(SMALL.layers, depth)
    assert SMALL.seconds[0] < equal[0] < SMALL.seconds[1]
    assert equal[1] == np.inf
    same = along(knees.paths[0], {LAYER: SMALL.layers[:1], SECOND: equal[:1]})
    assert same.peak_force / knees.healthy.peak_force == pytest.approx(1.0, abs=DASHPOT)


def test_on_the_healthy_path_raised_the_force_drops_beyond_a_rise(knees: Knees) -> None:
    lost = turning(knees, *CHOSEN[0])
    assert lost == pytest.approx(0.2086e-3, abs=1e-7)  # as the reproduction's, on the fitted curve
    less, more = (float(along(knees.paths[0], SHIPPED_KNEE, rise).peak_force[0]) for rise in (lost - 5e-6, lost + 5e-6))
    assert more < knees.healthy.peak_force[0] < less
    assert along(knees.paths[0], SHIPPED_KNEE, 1e-3).peak_force[0] == 0.0


def test_needed_depth_is_where_the_law_has_the_force() -> None:
    layers, seconds = np.array([0.3e-3, 0.5e-3, 3e-3]), np.array([1e7, 3e9, 3e9])
    force = np.full(3, 1600.0)
    assert rest_force(layers, seconds, needed_depth(layers, seconds, force)) == pytest.approx(force)


def test_a_knee_alone_is_the_sweeps_to_the_bit_and_near_the_reference(knees: Knees) -> None:
    assert checks.different(knees, [SHIPPED_CELL]) == 0
    judged = checks.judged(knees, SHIPPED_CELL)
    assert judged.depth < TOLERANCE["fidelity.tolerance"]
    assert judged.bound < 1e-12


def test_page_and_table_are_of_the_study_file() -> None:
    grid = whole()
    assert 2 * np.prod(grid.shape) == 10_000
    assert grid.seconds[15] == pytest.approx(SHIPPED.stiffness_2, rel=FOUR_DIGITS)
    assert STUDY.read_text(encoding="utf-8").strip() in PAGE.read_text(encoding="utf-8")
    with (ROOT / "docs" / "studies" / "osteoarthritis.csv").open(encoding="utf-8", newline="") as file:
        header, *rows = csv.reader(file)
    assert tuple(header) == HEADER
    assert len(rows) == 2 * len(grid.layers) * len(grid.seconds)
