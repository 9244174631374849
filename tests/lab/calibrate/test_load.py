"""`knee-contact calibrate BAG`: a person's constants of the load estimate are found, or it is told why not."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from knee_contact_ros import UsageError, calibrate, estimate_load
from knee_contact_ros.commands.main import main
from knee_contact_ros.parameters.files import load_parameters, values_set_in
from knee_contact_ros.parameters.schema import LoadParameters
from tests.lab.calibrate.legs import BODY, EPOCH, FREE, STEP, TRUE, WEIGHT, noise, trial, walk, write_sensors

VALUES = [f"-p{name}:={value}" for name, value in BODY.items()]
BOTH = ["person.moment_arm_scale", "person.tone"]


def run(*arguments: object) -> int:
    return main(["calibrate", *map(str, arguments)])


def fitted(bag: Path, free: Any = FREE, *params: Any, **options: Any) -> Any:
    return calibrate(bag, [*params, BODY], free, starts=1, **options)


@pytest.mark.parametrize("correlation", [0.0, 0.9])
def test_the_truth_is_found_within_its_intervals(tmp_path: Path, correlation: float) -> None:
    # Of 24 one in twenty may fail; P(more than 4) is 0.6 %, and the seeds are fixed. Without counting the samples as
    # fewer, about half of those with correlated noise would.
    missed = 0
    for seed in range(8):
        bag = trial(tmp_path, seed, correlation=correlation)
        found = fitted(bag)
        bag.unlink()
        for name, true in TRUE.items():
            low, high, *opened = found.intervals[name]
            assert low < found.values[name] < high
            missed += not low <= true <= high
            assert opened == [False, False] or correlation
        assert found.rms["axial_force"] == pytest.approx(60.0, rel=0.2 if correlation == 0.0 else 0.6)
        assert bool(found.warnings) == (correlation > 0.0)
    assert missed <= 4


@pytest.mark.parametrize("level", ["ground_force", "knee_moment", "ankle_moment"])
def test_what_is_fitted_is_the_estimators_own_answer(tmp_path: Path, level: str) -> None:
    how = ["load/inverse_dynamics", {"level": level}]
    bag = trial(tmp_path, 0, *how, size=0.0)
    found = fitted(bag, FREE, *how, with_intervals=False)
    for name, true in TRUE.items():
        assert found.values[name] == pytest.approx(true, rel=1e-6)  # a search ends at 1e-10 of its coordinates
    estimated = estimate_load(bag, [*how, BODY, found.to_parameters()])
    np.testing.assert_array_equal(found.predicted["axial_force"], estimated["axial_force"])
    assert estimated["calibrated"].all()
    assert estimated["standard_deviation"][0] == pytest.approx(0.01 * WEIGHT)  # the least that is allowed
    assert f"level {level}" in found.remarks[0]


def test_mass_and_height_are_fitted_if_asked(tmp_path: Path) -> None:
    how = ["load/inverse_dynamics"]
    bag = trial(tmp_path, 1, *how, size=1.0)
    found = fitted(bag, ["person.mass", "person.height"], *how, {**TRUE, "person.mass": 80.0})
    # `BODY` is given behind, so the mass starts at its true value; the data hold it there
    assert found.values["person.mass"] == pytest.approx(70.0, rel=0.01)
    low, high, *_ = found.intervals["person.height"]
    assert low < 1.75 < high


def test_standing_tells_one_number_and_that_is_told_by_name(tmp_path: Path) -> None:
    bag = trial(tmp_path, 2, standing=True)
    pair = fitted(bag, BOTH, {"person.co_contraction": 0.35})
    (trade,) = (each for each in pair.warnings if "trade off" in each)
    assert trade.startswith("person.moment_arm_scale and person.tone trade off (correlation 1.0000)")
    assert "cannot tell them apart" in trade
    all_three = fitted(bag)
    (trade,) = (each for each in all_three.warnings if "trade off" in each)
    assert trade.startswith(
        "person.moment_arm_scale, person.co_contraction and person.tone trade off: changed together"
    )
    bag.unlink()
    assert fitted(trial(tmp_path, 2)).warnings == ()


def test_a_reference_without_any_noise_or_motion_is_fitted_all_the_same(tmp_path: Path) -> None:
    """The spread of equal values is that of roundings, beside which every misfit is beyond all models."""
    flexion, ground = walk(200, standing=True)
    axial = 1051.6123456789
    assert 0.0 < np.std(np.full(200, axial)) < 1e-12
    bag = write_sensors(tmp_path / "b.mcap", flexion, ground, {EPOCH + STEP * place: axial for place in range(200)})
    tone = fitted(bag, ["person.tone"]).values["person.tone"]
    told = estimate_load(bag, {**BODY, "person.tone": tone})
    assert told["axial_force"] == pytest.approx(np.full(200, axial), rel=1e-6)


def test_samples_without_a_reference_and_flagged_ones_are_left_out_and_counted(tmp_path: Path) -> None:
    flexion, ground = walk(400)
    whole = trial(tmp_path, 3, size=0.0)
    true = calibrate(whole, [BODY, TRUE], ["person.tone"], with_intervals=False, starts=1).measured.answers[
        "axial_force"
    ]
    # Every third stamp has a reference, but none of a quarter second; and for so long no angle comes.
    reference = {EPOCH + STEP * place: float(true[place]) for place in range(0, 400, 3) if not 100 < place < 125}
    bag = write_sensors(tmp_path / "gaps.mcap", flexion, ground, reference, without_angle=range(201, 226))
    found = fitted(bag, with_intervals=False)
    column = found.measured.answers["axial_force"]
    assert found.measured.left_out == {"flagged": 25, "without a reference": 26}
    assert np.flatnonzero(np.isnan(column)).tolist() == [*range(100, 126), *range(201, 226)]
    assert found.measured.number == 400 - 25 - 26
    assert "samples: 349 fitted; left out: 25 flagged, 26 without a reference" in found.remarks
    assert found.residuals["axial_force"].shape == (400,)
    assert found.values["person.tone"] == pytest.approx(0.25, rel=0.1)  # interpolated over 30 ms, it is a bit off
    how = ["load/inverse_dynamics", BODY, TRUE]  # at every sample, flagged ones and those behind them, too
    predicted = calibrate(bag, how, ["person.tone"], with_intervals=False, starts=1)
    estimated = estimate_load(bag, [*how, predicted.to_parameters()])
    np.testing.assert_array_equal(predicted.predicted["axial_force"], estimated["axial_force"])


def test_the_command_writes_parameters_that_the_load_node_takes(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    bag, output = trial(tmp_path, 4, correlation=0.8), tmp_path / "me.yaml"
    free = [word for name in FREE for word in ("--free", name)]
    assert run(bag, "--params", "load/insole", *VALUES, *free, "--starts", 1, "--output", output) == 0
    said = capsys.readouterr()
    for part in ("95 % interval", "person.co_contraction", "axial_force: RMS", "body weights, r 0.9", "400 fitted"):
        assert part in said.out
    assert re.search(r"warning: axial_force: what is left is alike .*: 400 samples count as \d+, and", said.err)
    parameters = load_parameters(["load/insole", str(output)], LoadParameters)
    assert parameters.calibrated
    assert 0.05 < parameters.standard_deviation < 0.15  # 60 N of 686 N
    assert parameters.person.moment_arm_scale == pytest.approx(0.9, rel=0.1)
    assert set(values_set_in(output, LoadParameters)) == {*FREE, "calibrated", "standard_deviation"}
    text = output.read_text(encoding="utf-8")
    assert "insole.yaml, person.mass 70.0" in text
    assert "# Data: trial.mcap, sha256 " in text
    assert "# Standard_deviation is the RMS of what is left of these data; in another trial of the same person" in text
    assert main(["estimate-load", str(bag), "--params", str(output), "--output", str(tmp_path / "out.mcap")]) == 0
    assert "fitted to this person's knee" in capsys.readouterr().out


def test_topics_may_have_other_names(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    bag = trial(tmp_path, 5, topic="/implant/force")
    free, output = ("--free", "person.tone", "--starts", 1, "--no-intervals"), ("--output", tmp_path / "me.yaml")
    assert run(bag, *free, *output) == 2
    assert "has no topic /joint_reaction_force" in (said := capsys.readouterr().err)
    assert "its topics: /ground_reaction_force, /implant/force, /joint_states; --remap joint_reaction_force:=" in said
    assert run(bag, *free, *output, "--remap", "joint_reaction_force:=/implant/force") == 0
    found = fitted(bag, ["person.tone"], remap={"joint_reaction_force": "/implant/force"}, with_intervals=False)
    assert found.values["person.tone"] > 0.0
    (tmp_path / "left").mkdir()
    bag = trial(tmp_path / "left", 5, namespace="/left")
    assert run(bag, *free, *output, "--overwrite") == 2
    assert "say --namespace left" in capsys.readouterr().err
    assert run(bag, *free, *output, "--overwrite", "--namespace", "left") == 0


def test_an_estimate_of_our_own_is_no_reference(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    bag = write_sensors(tmp_path / "sensors.mcap", *walk(200))
    assert main(["estimate-load", str(bag), "--output", str(tmp_path / "loads.mcap")]) == 0
    capsys.readouterr()
    assert run(tmp_path / "loads.mcap", "--free", "person.tone", "--starts", 1, "--output", tmp_path / "me.yaml") == 0
    assert "the bag also has /load_estimate: its /joint_reaction_force is likely an estimate" in capsys.readouterr().err


def whole(folder: Path) -> Path:
    return trial(folder, 6, count=150)


def without_reference(folder: Path) -> Path:
    return write_sensors(folder / "trial.mcap", *walk(150))


def elsewhere(folder: Path) -> Path:
    """Its reference is of another time."""
    return write_sensors(folder / "trial.mcap", *walk(150), {EPOCH - STEP: 500.0, EPOCH - 2 * STEP: 500.0})


def of_nothing(folder: Path) -> Path:
    return write_sensors(folder / "trial.mcap", *walk(150), {EPOCH: float("nan"), EPOCH + STEP: float("inf")})


def short(folder: Path) -> Path:
    return write_sensors(folder / "trial.mcap", *walk(150), {EPOCH + STEP: 500.0})


@pytest.mark.parametrize(
    ("bag", "arguments", "reason"),
    [
        (
            without_reference,
            FREE,
            "; its topics: /ground_reaction_force, /joint_states; --remap joint_reaction_force:=TOPIC names a measured",
        ),
        (
            elsewhere,
            FREE,
            "no sample can be fitted to the reference (150 without a reference)",
        ),
        (of_nothing, FREE, "no message on /joint_reaction_force can be a reference (2 not_finite)"),
        (short, FREE, "1 samples can be fitted, for 3 parameters; more are needed than parameters are free"),
        (whole, ["person.ton"], "--free person.ton: it is no parameter that can be fitted; did you mean person.tone?"),
        (whole, ["contact.stiffness"], "it is one of the contact, which is fitted to a table; to a bag person.mass, "),
        (
            whole,
            ["motion_window"],
            "--free motion_window: it is none of a person; allowed are person.mass, person.heig",
        ),
        (whole, [], "Missing option '--free'"),
        (whole, ["person.tone=3:4"], "range 3:4 is not allowed; it must lie in 0 to 2"),
        (whole, ["person.tone", "--params", "healthy"], "no parameters for node knee_load; found /**/knee_contact"),
        (whole, ["person.tone", "-p", "person.ton:=1"], "unknown parameter person.ton; did you mean person.tone?"),
        (whole, ["person.tone", "-p", "knee.joint_name:=kne"], "joint_states has no joint 'kne'; it has hip, knee, an"),
        (whole, ["person.tone", "--sigma", "gap=1"], "--sigma gap: it was not measured; measured are axial_force"),
        (whole, ["person.tone", "--remap", "force:=/x"], "FROM must be joint_states or ground_reaction_force or joint"),
    ],
)
def test_what_is_wrong_is_told_in_one_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], bag: Callable[[Path], Path], arguments: list[str], reason: str
) -> None:
    output = tmp_path / "me.yaml"
    free = [
        word for word in arguments if word.startswith(("person.ton", "person.mo", "person.co", "contact", "motion"))
    ]
    others = [word for word in arguments if word not in free or ":=" in word]
    given = [word for name in free if ":=" not in name for word in ("--free", name)]
    assert run(bag(tmp_path), "--output", output, *given, *others) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert reason in line
    assert [path.name for path in tmp_path.iterdir()] == ["trial.mcap"]


def test_a_table_has_no_topics_and_no_person(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    table = tmp_path / "trial.csv"
    table.write_text("time,flexion_angle,load,penetration_depth\n0,0,100,1e-4\n1,0,100,1e-4\n", encoding="utf-8")
    output = ("--output", tmp_path / "me.yaml")
    assert run(table, "--free", "person.tone", *output) == 2
    assert "it is one of the load node, which is fitted to a bag" in capsys.readouterr().err
    assert run(table, "--free", "contact.stiffness", "--namespace", "left", *output) == 2
    assert "a table has columns, and no topics" in capsys.readouterr().err
    with pytest.raises(UsageError, match=r"^free person\.ton: it is no parameter"):
        calibrate(write_sensors(tmp_path / "a.mcap", *walk(10)), None, ["person.ton"])


def test_an_interruption_leaves_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    bag = whole(tmp_path)

    def interrupted(*_: object, **__: object) -> None:
        raise KeyboardInterrupt

    with monkeypatch.context() as patched:
        patched.setattr("knee_contact_ros.lab.calibrate.intervals", interrupted)
        assert run(bag, "--free", "person.tone", "--starts", 1, "--output", tmp_path / "me.yaml") == 130
    assert list(tmp_path.iterdir()) == [bag]
    monkeypatch.setattr("knee_contact_ros.lab.calibrate.parameter_file", interrupted)
    assert run(bag, "--free", "person.tone", "--starts", 1, "--output", tmp_path / "me.yaml") == 130
    assert list(tmp_path.iterdir()) == [bag]
    assert capsys.readouterr().err.count("interrupted") == 2


def test_noise_that_is_drawn_is_what_it_is_said_to_be() -> None:
    drawn = noise(20_000, 0, 0.9)
    assert drawn.std() == pytest.approx(60.0, rel=0.1)  # 1000 independent values: 2 %
    assert np.corrcoef(drawn[1:], drawn[:-1])[0, 1] == pytest.approx(0.9, abs=0.01)
