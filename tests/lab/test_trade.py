"""`knee-contact trade`: errors and costs of a bag at all settings, and what it recommends."""

import sys
from dataclasses import replace

import numpy as np
import pytest

from knee_contact_ros import UsageError, load_model, solve
from knee_contact_ros.lab.trade import (
    LEVELS,
    MEASURED_LEVELS,
    REFERENCE_TOLERANCE,
    TOLERANCES,
    Setting,
    Trade,
    advice,
    measure,
)
from knee_contact_ros.model.types import Status
from tests.helpers.commands import run
from tests.offline.test_solve import make_bag

pytest.importorskip("matplotlib", reason="needs the extra trade")


def of(found, level, tolerance):
    (setting,) = (
        each for each in found.settings if (each.level, each.tolerance) == (level, tolerance)
    )
    return setting


@pytest.fixture(scope="module")
def arthritic(right_bag):
    return solve(right_bag, ["osteoarthritis", "mri_knee"])


@pytest.fixture(scope="module")
def found(arthritic):
    return measure(arthritic)


def test_errors_are_those_against_the_tightest_run(found, arthritic):
    assert [(each.level, each.tolerance) for each in found.settings] == [
        (n, t) for n in MEASURED_LEVELS for t in TOLERANCES
    ]
    assert found.ticks == len(arthritic)

    def run(level, tolerance):
        model = load_model(["osteoarthritis", "mri_knee", {"fidelity.level": level}])
        return replace(model, tolerance=tolerance).run(
            arthritic.time, arthritic.flexion_angle, arthritic.load
        )

    exact = run("dynamic", REFERENCE_TOLERANCE)
    for level, tolerance in (("quasi_static", 1e-4), ("dynamic", 1e-6), ("dynamic", 1e-9)):
        own, setting = run(level, tolerance), of(found, level, tolerance)
        apart = (
            own.contact_point.x - exact.contact_point.x,
            own.contact_point.y - exact.contact_point.y,
        )
        assert setting.depth == np.abs(own.penetration_depth - exact.penetration_depth).max()
        assert setting.force == np.abs(own.contact_force - exact.contact_force).max()
        assert setting.point == np.hypot(*apart).max() > 0.0
        assert setting.evaluations == own.evaluations.mean()
        assert setting.flagged == np.mean((own.status & Status.NOT_CONVERGED) != 0)
        assert setting.microseconds > 0.0
    assert found.reference_error < of(found, "dynamic", 1e-9).depth
    loaded = replace(
        load_model(["osteoarthritis", "mri_knee"]), tolerance=REFERENCE_TOLERANCE
    ).run(arthritic.time, arthritic.flexion_angle, 1.01 * arthritic.load)
    worth = np.abs(
        loaded.penetration_depth - exact.penetration_depth
    ).max()  # in contact throughout
    assert found.worth == pytest.approx(worth, rel=1e-3)
    unknown = arthritic.copy()
    unknown.model = None
    with pytest.raises(UsageError, match="give --params FILE"):
        measure(unknown)


def setting(level, tolerance, depth, flagged, evaluations):
    return Setting(level, tolerance, depth, 0.0, 0.0, flagged, evaluations, 1.0)


STATIC, DYNAMIC = (
    setting("quasi_static", 1e-5, 1e-6, 0.0, 2.0),
    setting("dynamic", 1e-5, 1e-8, 0.0, 9.0),
)


@pytest.mark.parametrize(
    ("settings", "level", "tolerance"),
    [
        ([STATIC, DYNAMIC], "quasi_static", "1e-05"),
        ([STATIC._replace(flagged=0.1), DYNAMIC], "dynamic", "1e-05"),
        ([DYNAMIC._replace(tolerance=1e-4), DYNAMIC], "dynamic", "0.0001"),
        ([DYNAMIC, DYNAMIC._replace(tolerance=1e-6)], "dynamic", "1e-05"),
        (
            [DYNAMIC._replace(depth=1e-4), DYNAMIC._replace(tolerance=1e-6, evaluations=12.0)],
            "dynamic",
            "1e-06",
        ),
    ],
    ids=[
        "cheapest",
        "it flags too much",
        "the errors count, not the tolerance",
        "largest tolerance",
        "too large an error",
    ],
)
def test_the_cheapest_setting_that_is_good_enough_is_recommended(settings, level, tolerance):
    said = advice(Trade(settings, 100, 2e-5, 1e-12))
    assert f"fidelity.level {level} with fidelity.tolerance {tolerance}: " in said
    assert advice(Trade(settings, 100, 1e-10, 1e-12)).startswith("No setting flags")


def test_both_compartments_count_and_a_reset_begins_anew(right_bag):
    both = solve(right_bag, "both_compartments")
    assert measure(both, 1e-6).ticks == 2 * len(both)
    again = solve(right_bag)
    twice = np.concatenate([again, again])
    twice["status"][len(again)] |= Status.TIME_RESET
    twice.model = again.model
    one, two = (of(measure(each, 1e-6), "dynamic", 1e-6) for each in (again, twice))
    assert (one.depth, one.evaluations) == (two.depth, two.evaluations)


def test_heights_that_are_prescribed_are_taken_from_the_answers():
    model = load_model({"drive": "displacement"})
    time = 1e-2 * np.arange(50)
    series = model.run(time, 0.1 + time, 0.0 * time, 0.034 - 1e-3 * np.sin(9.0 * time))
    found = measure(series)
    assert all(each.depth == each.force == 0.0 for each in found.settings)
    assert advice(found).startswith("Every setting gives the same")


def test_the_command_prints_a_table_and_a_sentence_and_draws(right_bag, tmp_path, capsys):
    picture = tmp_path / "trade.png"
    options = f"-p femur.mass:=5.0 --worth 1e-4 --picture {picture}"
    assert run(f"trade {right_bag} {options}") == 0
    printed, errors = capsys.readouterr()
    assert errors == ""
    for level in LEVELS.keys() - {"auto"}:
        assert printed.count(f" {level} ") == len(TOLERANCES) + (
            level in printed.partition("Take fidelity.level")[2]
        )
    assert "Take fidelity.level quasi_static with fidelity.tolerance 0.001: " in printed
    assert printed.endswith(f"Picture: {picture}\n")
    assert picture.read_bytes().startswith(b"\x89PNG")
    assert run(f"trade {right_bag} --remap joint_states") == 2
    assert capsys.readouterr().err.startswith("knee-contact: --remap 'joint_states': it must be")


def test_doubts_come_before_the_advice_and_damage_ends_with_1(
    right_bag,
    sensors_bag,
    tmp_path,
    monkeypatch,
    capsys,
):
    bag = tmp_path / "cut.mcap"
    picture = f"--picture {tmp_path}/trade.png"
    with monkeypatch.context() as patched:
        patched.setattr("sys.stderr", sys.stdout)
        bag.write_bytes((right_bag / "gait2354_right_0.mcap").read_bytes()[:40_000])
        assert run(f"trade {bag} -p contact.stiffness:=2500.0 {picture}") == 1
        said = capsys.readouterr().out
    assert said.index("knee-contact: warning: contact.stiffness") < said.index(
        "Take fidelity.level"
    )
    assert said.splitlines()[-1].startswith(
        f"knee-contact: bag {bag} is damaged, and solved as far as it can be read"
    )
    assert run(f"trade {sensors_bag} {picture}") == 2
    assert (
        "; --remap joint_reaction_force:=TOPIC or --namespace NAME reads"
        in capsys.readouterr().err
    )
    one = make_bag(tmp_path / "one.mcap", [(0, 0.1, 800.0)])
    assert run(f"trade {one} {picture}") == 2
    assert (
        capsys.readouterr().err
        == f"knee-contact: bag {one}: only one tick could be computed, but errors need at least two\n"
    )
