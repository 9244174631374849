"""The studies that judge the error estimates: what they count, and that scenes come again."""

from concurrent.futures import ProcessPoolExecutor
from importlib.util import find_spec
from multiprocessing import get_context
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("tabulate", reason="the studies' tables")

from knee_contact_ros.model import compiler, kernel, solver, step_control, steps, ticks
from knee_contact_ros.model.types import ROW, Status
from studies.honesty.cut import PARTS
from studies.honesty.judging import judge
from studies.honesty.kinds import SETTINGS, STUDIES, TIGHT
from studies.honesty.knobs import OFF, knobs, marked, set_constants, variant
from studies.honesty.scenes import FAMILIES, TICKS, draw
from studies.reference import LAWS, Solution

TOLERANCE = 1e-6
EXACT, UNKNOWN = 1e-18, np.nan


def series(depth, estimate, flagged):
    rows = np.zeros(len(depth), dtype=ROW).view(np.recarray)
    rows.penetration_depth = np.maximum(depth, 0.0)
    rows.gap = np.maximum(-np.array(depth), 0.0)
    rows.error_estimate = estimate
    rows.status = np.where(flagged, Status.NOT_CONVERGED, Status.OK)
    return rows


def truth(depth, bound):
    column = np.array(depth)
    return Solution(column, column, 0.0 * column, column, np.array(bound), np.array(bound))


def test_scenes_come_again_and_are_of_all_kinds():
    drawn = [draw(seed) for seed in range(120)]
    for scene, again in zip(drawn, map(draw, range(120)), strict=True):
        assert scene.content() == again.content()
        assert len(scene.time) == len(scene.load) == len(scene.angle) == TICKS
        assert np.all(np.diff(scene.time) > 0.9e-4)
    assert {scene.law for scene in drawn} == set(LAWS)
    assert {scene.family for scene in drawn} == set(FAMILIES)
    assert len({scene.content() for scene in drawn}) == 120


def test_what_counts_as_wrong():
    """Right; covered though beyond the tolerance; not covered; not finite; the same where the reference is unknown."""
    exact = [1e-3, 1e-3, 1e-3, -1e-3, 1e-3, 1e-3, 1e-3]
    ours = [1e-3 + 1e-7, 1e-3 + 2e-6, 1e-3 + 2e-6, -1e-3 + 3e-6, np.nan, 1e-3 + 1e-7, 1e-3 + 1.0]
    estimate = [2e-7, 4e-6, 1e-6, 1e-7, 1e-7, np.nan, 1e-9]
    flagged = [False, True, True, False, False, False, False]
    bound = [EXACT] * 5 + [UNKNOWN, UNKNOWN]
    judged = judge(series(ours, estimate, flagged), truth(exact, bound), TOLERANCE)
    assert judged.depth.known.tolist() == [True, True, True, True, True, False, False]
    assert judged.depth.covered.tolist() == [True, True, False, False, False, False, False]
    assert judged.depth.wrong.tolist() == [False, False, False, True, True, True, False]
    assert judged.apart.tolist() == [False, False, False, True, False, False, False]
    assert judged.claimed.tolist() == [False] * 5 + [True, False]
    assert judged.falsely.tolist() == [False] * 7
    exact_but_flagged = judge(
        series([1e-3] * 2, [2e-6] * 2, [True, False]), truth([1e-3] * 2, [EXACT] * 2), TOLERANCE
    )
    assert exact_but_flagged.falsely.tolist() == [True, False]
    assert judged.depth.ratio[:2] == pytest.approx([2.0, 2.0])


@pytest.mark.parametrize(
    ("study", "runs"),
    [("scenes", 2 * len(SETTINGS)), ("cut", len(PARTS) - 1), ("tight", 2 * len(TIGHT))],
)
def test_a_number_is_judged(study, runs):
    rows = list(STUDIES[study][0](1_000_000))
    assert len(rows) == runs
    assert sum(one.known for one in rows) > 0
    assert not any(one.wrong or one.not_finite for one in rows)


def test_tuned_constants_are_few_and_each_has_a_study_that_would_notice():
    tuned = knobs()
    assert len(tuned) <= 26
    assert sorted(one.name for one in tuned) == sorted(OFF)
    sources = [file.read_text() for file in Path(steps.__file__).parent.glob("*.py")]
    of_surfaces = 3  # judged by brute force, in tests/model/test_surfaces.py
    assert sum(text.count("Tuned") for text in sources) == len(tuned) + of_surfaces


def test_a_constant_that_is_switched_off_reaches_all_modules(monkeypatch):
    for module in (steps, solver):
        monkeypatch.setattr(module, "MAX_EXPLICIT_STEP", module.MAX_EXPLICIT_STEP)
    set_constants({"MAX_EXPLICIT_STEP": 1.5})
    assert steps.MAX_EXPLICIT_STEP == solver.MAX_EXPLICIT_STEP == 1.5


def translated(values):
    set_constants(values)
    return compiler.translate(ticks.run, kernel.example_knee())


@pytest.mark.skipif(find_spec("numba") is None, reason="needs the extra compile")
def test_a_variant_is_what_compiling_other_constants_gives():
    """The object codes are the same bytes: no constant is part of a number that Python has computed."""
    values = {"DAMPED_PHASE": step_control.DAMPED_PHASE, "VELOCITY_HORIZON": 0.1}
    off = {name: OFF[name] for name in values}
    work = [(marked, values), (translated, off)]
    pools = [ProcessPoolExecutor(1, get_context("spawn")) for _ in work]
    made = [pool.submit(*one) for pool, one in zip(pools, work, strict=True)]
    (code, marks), other = (one.result() for one in made)
    for pool in pools:
        pool.shutdown()
    host = compiler.host()
    assert compiler.object_code(variant(code, marks, off), host) == compiler.object_code(
        other, host
    )


def test_a_reference_that_is_no_better_than_the_model_judges_nothing():
    judged = judge(series([1e-3 + 2e-6], [1e-9], [False]), truth([1e-3], [1e-7]), TOLERANCE)
    assert not judged.depth.known.any()
    assert not judged.depth.wrong.any()
