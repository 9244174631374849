"""docs/load-validation.md says what the code gives, where the measurements are; and how it scores, by hand."""

from __future__ import annotations

from functools import partial
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from knee_contact_ros.joint_reaction.estimator import LEVELS
from knee_contact_ros.joint_reaction.leg import UNKNOWN, Joints, NetMoments
from tests import ROOT

pytest.importorskip("tabulate", reason="the studies' tables")

from benchmarks.report import save
from studies import moment_arms
from studies.load_validation import walks as opensim
from studies.load_validation.__main__ import main
from studies.load_validation.answers import (
    FITTED,
    VARIANTS,
    answers,
    covered,
    fitted,
    fitted_together,
    force_by,
    lines,
    peaks,
    score,
)
from studies.load_validation.sections import COMMAND, TITLE, sections
from studies.load_validation.walks import Constants, Moments, Walk, axial, plausible, walks
from studies.validation.data import is_there

PAGE = ROOT / "docs" / "load-validation.md"
MADE = Constants(1.3, 0.25, 0.15)


def made_up(name: str = "made up", seed: int = 1) -> Walk:
    """Three strides whose force is that of `MADE`, at the level that knows the ankle."""
    time = np.arange(300) * 0.01
    draw = np.random.default_rng(seed)
    phase = (time - 0.105) % 1.0
    vertical = np.where((phase < 0.6) & (time > 0.1), 700.0 * np.sin(np.pi * phase / 0.6) + 100.0, 0.0)
    rows = zip(
        draw.uniform(0.0, 1.0, 300).tolist(), draw.uniform(-30.0, 50.0, 300).tolist(),
        draw.uniform(-20.0, 90.0, 300).tolist(), vertical.tolist(), strict=True,
    )  # fmt: skip
    joints, nets = [], []
    for flexion, knee, ankle, force in rows:
        joints.append(Joints(flexion, UNKNOWN, UNKNOWN))
        nets.append(NetMoments(knee, ankle, force - 40.0, UNKNOWN))
    walk = Walk(
        name, 70.0, 1.75, time, vertical, joints, dict.fromkeys(LEVELS, nets), np.zeros(300), np.ones(300, dtype=bool)
    )
    return walk._replace(reference=axial(walk, "ankle_moment", MADE))


@pytest.fixture(scope="module")
def measured(reference_data: Path) -> list[Walk]:
    folder = reference_data / "instrumented_knee"
    if not is_there(folder):
        pytest.skip("the measurements of the instrumented knee are not on this machine")
    return walks(folder)


def test_without_the_measurements_nothing_is_made(tmp_path: Path) -> None:
    for arguments in ([], ["--data", str(tmp_path)]):
        result = CliRunner(env={"INSTRUMENTED_KNEE": ""}).invoke(main, [*arguments, "--output", str(tmp_path)])
        assert result.exit_code == 0
        assert "nothing is made" in result.output
    assert not list(tmp_path.iterdir())


def test_the_page_has_what_the_code_gives(measured: list[Walk], tmp_path: Path) -> None:
    told = PAGE.read_text(encoding="utf-8")
    save(tmp_path / "page.md", TITLE, COMMAND, sections(measured), told.splitlines()[2].split(" on ", 1)[1].rstrip("."))
    assert told.startswith((tmp_path / "page.md").read_text(encoding="utf-8"))


def test_what_was_asked_for_and_can_be_had(measured: list[Walk]) -> None:
    for each in answers(measured):
        if each.how == FITTED and each.level != "ground_force":
            found = score(each.walk, each.force)
            assert found.rms <= 0.35
            assert found.r >= 0.9


def test_deviations_hold_what_they_should(measured: list[Walk]) -> None:
    for each in answers(measured):
        deviation = np.array([each.deviation.at(force, each.walk.weight) for force in each.force.tolist()])
        for within in (each.walk.stance, ~each.walk.stance):
            one, two = covered(each.walk, each.force, deviation, within)
            assert one > 0.5
            assert two > 0.8


def test_a_fit_finds_the_constants_that_made_the_force() -> None:
    walk = made_up()
    assert fitted(walk, "ankle_moment") == pytest.approx(MADE, abs=1e-3)
    assert fitted_together([walk, made_up(seed=2)], ["ankle_moment"], MADE[0]) == pytest.approx(MADE, abs=1e-3)


def test_a_walk_is_told_by_the_other_one_alone() -> None:
    one, other = made_up("one"), made_up("other", 2)
    found = [*answers([one, other]), *lines([one, other])]
    other = other._replace(reference=2.0 * other.reference)
    changed = [*answers([one, other]), *lines([one, other])]
    for before, after in zip(found, changed, strict=True):
        of_the_other = after.walk.name == "one" and after.how != "defaults"
        assert np.array_equal(before.force, after.force) is not of_the_other
    for each in answers([made_up("one"), made_up("other", 2)]):
        if each.level == "ankle_moment" and each.how == FITTED:
            assert score(each.walk, each.force).rms < 1e-3


def test_the_first_variant_is_the_rule_of_the_package() -> None:
    walk = made_up()
    assert force_by(VARIANTS[0], walk, "ankle_moment", MADE) == pytest.approx(walk.reference, rel=1e-12)
    for variant in VARIANTS[3:]:
        assert not np.allclose(partial(force_by, variant)(walk, "ankle_moment", MADE), walk.reference)


def test_spikes_go_with_what_is_near_them() -> None:
    time = np.arange(100) * 0.015  # 0.1 s lies between samples
    moments = Moments(np.zeros(100), np.zeros(100))
    assert plausible(time, moments).all()
    moments.extension[30], moments.plantarflexion[70] = -81.0, 151.0
    left_out = np.flatnonzero(~plausible(time, moments))
    assert left_out.tolist() == [*range(24, 37), *range(64, 77)]


def test_steps_are_whole_ones_that_are_used() -> None:
    walk = made_up()
    first = walk.steps()
    assert [(round(walk.time[begin], 2), round(walk.time[end], 2)) for begin, end in first] == [
        (0.11, 0.71), (1.11, 1.71), (2.11, 2.71),
    ]  # fmt: skip
    walk.used[150] = False
    assert walk.steps() == [first[0], first[2]]


def test_scores_and_peaks_by_hand() -> None:
    walk = made_up()
    begin, end = walk.steps()[0]
    reference = np.full(300, 100.0)
    reference[begin + 1] = 5000.0  # a heel strike's, which is no peak of the stance
    reference[begin + 20], reference[begin + 45] = 1000.0, 800.0
    walk.used[:] = False
    walk.used[begin - 5 : end] = True
    walk = walk._replace(reference=reference)
    force = np.full(300, 100.0)
    force[begin + 22], force[begin + 45] = 1100.0, 400.0
    found = peaks(walk, force)
    assert [(each.half, each.measured, each.place) for each in found] == [
        ("first", 1000.0, begin + 20), ("second", 800.0, begin + 45),
    ]  # fmt: skip
    assert [each.error for each in found] == pytest.approx([0.1, -0.5])
    assert [each.late for each in found] == pytest.approx([0.02, 0.0])
    told = score(walk, reference + 70.0 * 9.80665)
    assert told.mean == told.rms == told.stance == pytest.approx(1.0)
    assert told.r == pytest.approx(1.0)
    assert covered(walk, reference + 50.0, np.full(300, 40.0), walk.stance) == (0.0, 1.0)


def test_without_opensim_there_is_a_sentence(tmp_path: Path) -> None:
    assert not opensim.is_there(tmp_path)
    assert not opensim.is_computed(tmp_path)
    if opensim.is_installed():
        pytest.skip("OpenSim is installed")
    model = tmp_path / "model.osim"
    model.write_text("")
    result = CliRunner().invoke(moment_arms.main, [str(model)])
    assert result.exit_code == 0
    assert "not installed" in result.output
