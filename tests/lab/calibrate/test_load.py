"""`knee-contact calibrate BAG`: a person's constants of the load estimate are found, or it is told why not."""

import re
from pathlib import Path

import numpy as np
import pytest

from knee_contact_ros import UsageError, calibrate, estimate_load
from knee_contact_ros.lab.calibrate import bags_in
from knee_contact_ros.parameters.files import load_parameters, values_set_in
from knee_contact_ros.parameters.load_schema import LoadParameters
from tests.helpers.commands import run
from tests.lab.calibrate.legs import BODY, EPOCH, FREE, STEP, TRUE, WEIGHT, trial, write_sensors

AXIAL = "axial_force"
TONE = "person.tone"
BODY_OPTIONS = " ".join(f"-p {name}:={value}" for name, value in BODY.items())


def fitted(bag, free=FREE, *params, **options):
    return calibrate(bag, [*params, BODY], free, starts=1, **options)


@pytest.mark.parametrize("correlation", [0.0, 0.9])
def test_the_truth_is_found_within_its_intervals(tmp_path, correlation):
    # Of 6 one in twenty may fail; P(more than 1) is 3 %, and the seeds are fixed. Without counting the samples as
    # fewer, about half of those with correlated noise would. `studies.calibration` counts thousands.
    missed = 0
    for seed in range(2):
        bag = trial(tmp_path, seed, count=200, correlation=correlation)
        found = fitted(bag)
        bag.unlink()
        for name, true in TRUE.items():
            low, high, *opened = found.intervals[name]
            assert low < found.values[name] < high
            missed += not low <= true <= high
            assert opened == [False, False] or correlation
        assert found.rms[AXIAL] == pytest.approx(60.0, rel=0.2 if correlation == 0.0 else 0.6)
        assert bool(found.warnings) == (correlation > 0.0)
    assert missed <= 1


@pytest.mark.parametrize("level", ["ground_force", "knee_moment", "ankle_moment"])
def test_what_is_fitted_is_the_estimators_own_answer(tmp_path, level):
    how = ["load/inverse_dynamics", {"level": level}]
    bag = trial(tmp_path, 0, *how, size=0.0)
    found = fitted(bag, FREE, *how, with_intervals=False)
    assert found.values == pytest.approx(
        TRUE, rel=1e-6
    )  # a search ends at 1e-10 of its coordinates
    again = calibrate(bag, [*how, BODY, found.values], FREE, starts=1, with_intervals=False)
    assert again.also == {}  # of constants that are right already nothing is gained
    assert "calibrating gains nothing: the error is 0.000 body weights" in again.warnings[-1]
    estimated = estimate_load(bag, [*how, BODY, found.to_parameters()])
    np.testing.assert_array_equal(found.predicted[AXIAL], estimated[AXIAL])
    assert estimated["calibrated"].all()
    assert estimated["standard_deviation"][0] == pytest.approx(
        0.01 * WEIGHT
    )  # the least that is allowed
    assert f"level {level}" in found.remarks[0]


def test_each_of_several_bags_is_left_out_and_the_gain_is_reported(tmp_path, capsys):
    """Bags of one person whose noise differs: the file tells the error in a bag that was not fitted to."""
    bags = []
    for seed, size in ((5, 40.0), (6, 80.0)):
        (tmp_path / str(seed)).mkdir()
        bags.append(trial(tmp_path / str(seed), seed, count=200, size=size))
    found = fitted(bags, with_intervals=False)
    assert found.measured.number == 400
    assert found.values == pytest.approx(TRUE, rel=0.1)
    alone = [fitted(bag, with_intervals=False) for bag in reversed(bags)]
    remarks = [line for line in found.remarks if "constants of the other bags" in line]
    for bag, others, line in zip(bags, alone, remarks, strict=True):
        loads = estimate_load(bag, [BODY, others.to_parameters()])[AXIAL]
        reference = fitted(bag, [TONE], with_intervals=False).measured.answers[AXIAL]
        error = float(np.sqrt(np.mean((loads - reference) ** 2))) / WEIGHT
        assert line.startswith(f"bag {bag.name}: {error:.3f} body weights")
    left_out = [float(line.split(": ")[1].split(" ")[0]) for line in remarks]
    assert found.also["standard_deviation"] == pytest.approx(
        np.sqrt(np.mean(np.square(left_out))), abs=1e-3
    )
    assert re.search(
        r"takes the error from 0\.\d+ to 0\.0\d+ body weights in a bag that it has not",
        found.remarks[-1],
    )
    table = tmp_path / "table.csv"
    table.write_text("time,flexion_angle\n0,0\n", encoding="utf-8")
    both = f"calibrate {bags[0]} {bags[1]}"
    options = f"--free person.tone --output {tmp_path}/me.yaml"
    assert run(f"{both} --no-intervals {options} {BODY_OPTIONS}") == 0
    assert "constants of the other bags" in capsys.readouterr().out
    assert run(f"{both} {bags[0]} {options} --overwrite") == 2
    assert "are the same: each bag is left out in turn" in capsys.readouterr().err
    assert run(f"calibrate {bags[0]} {table} {options}") == 2
    error = "table.csv: it is not a bag; several bags can be given, but only one table"
    assert error in capsys.readouterr().err
    assert [*map(bags_in, ("a.mcap", "a.db3.partial", "a.mcap.csv"))] == [
        [Path("a.mcap")],
        [Path("a.db3.partial")],
        [],
    ]


def test_mass_and_height_are_fitted_if_asked(tmp_path):
    how = ["load/inverse_dynamics"]
    bag = trial(tmp_path, 1, *how, size=1.0)
    found = fitted(bag, ["person.mass", "person.height"], *how, {**TRUE, "person.mass": 80.0})
    # `BODY` is given behind, so the mass starts at its true value; the data hold it there
    assert found.values["person.mass"] == pytest.approx(70.0, rel=0.01)
    assert found.intervals["person.height"].low < 1.75 < found.intervals["person.height"].high


def test_standing_still_determines_one_number_and_a_warning_names_what_trades_off(
    tmp_path,
):
    bag = trial(tmp_path, 2, standing=True)
    all_three = fitted(bag, with_intervals=False)
    pair = fitted(bag, [FREE[0], TONE], {"person.co_contraction": 0.35}, with_intervals=False)
    words = "person.moment_arm_scale and person.tone trade off: person.moment_arm_scale 10 % up with person.tone"
    assert any(
        each.startswith(words) and "cannot tell them apart" in each for each in pair.warnings
    )
    # Of three that make one number two directions are free, and any two of them may be named.
    trades = [
        each
        for each in all_three.warnings
        if "trade off" in each and "cannot tell them apart" in each
    ]
    assert all(any(name in each for each in trades) for name in FREE)


def test_samples_without_a_reference_and_flagged_ones_are_left_out_and_counted(
    tmp_path,
):
    true = fitted(
        trial(tmp_path, 3, size=0.0), [TONE], TRUE, with_intervals=False
    ).measured.answers[AXIAL]
    # Every third stamp has a reference, but none of a quarter second; and for so long no angle comes.
    reference = {
        EPOCH + STEP * place: float(true[place])
        for place in range(0, 400, 3)
        if not 100 < place < 125
    }
    bag = write_sensors(tmp_path / "gaps.mcap", 400, reference, without_angle=range(201, 226))
    found = fitted(bag, with_intervals=False)
    column = found.measured.answers[AXIAL]
    assert found.measured.left_out == {"flagged": 25, "without a reference": 26}
    assert np.flatnonzero(np.isnan(column)).tolist() == [*range(100, 126), *range(201, 226)]
    assert found.measured.number == 400 - 25 - 26
    assert "samples: 349 fitted; left out: 25 flagged, 26 without a reference" in found.remarks
    assert found.residuals[AXIAL].shape == (400,)
    assert found.values[TONE] == pytest.approx(
        0.25, rel=0.1
    )  # interpolated over 30 ms, it is a bit off


def test_the_command_writes_parameters_that_the_load_node_takes(tmp_path, capsys):
    bag, output = trial(tmp_path, 4, correlation=0.8), tmp_path / "me.yaml"
    free = " ".join(f"--free {name}" for name in FREE)
    command = f"calibrate {bag} --params load/insole {BODY_OPTIONS} {free} --starts 1"
    assert run(f"{command} --output {output}") == 0
    printed = capsys.readouterr()
    for part in (
        "95 % interval",
        "person.co_contraction",
        "axial_force: RMS",
        "body weights, r 0.9",
        "400 fitted",
    ):
        assert part in printed.out
    warning = (
        r"warning: axial_force: the residuals are correlated .*: 400 samples count as \d+, and"
    )
    assert re.search(warning, printed.err)
    parameters = load_parameters(["load/insole", str(output)], LoadParameters)
    assert parameters.calibrated
    assert 0.05 < parameters.standard_deviation < 0.15  # 60 N of 686 N
    assert parameters.person.moment_arm_scale == pytest.approx(0.9, rel=0.1)
    assert set(values_set_in(output, LoadParameters)) == {
        *FREE,
        "calibrated",
        "standard_deviation",
    }
    text = output.read_text(encoding="utf-8")
    for part in (
        "insole.yaml, person.mass 70.0",
        "# Data: trial.mcap, sha256 ",
        "# Standard_deviation is the RMS error on these data; on another trial of the same person",
    ):
        assert part in text
    assert run(f"estimate-load {bag} --params {output} --output {tmp_path}/out.mcap") == 0
    assert "fitted to this person's knee" in capsys.readouterr().out


def test_topics_may_have_other_names(tmp_path, capsys):
    bag = trial(tmp_path, 5, topic="/implant/force")
    options = f"--free {TONE} --starts 1 --no-intervals --output {tmp_path}/me.yaml --overwrite"
    assert run(f"calibrate {bag} {options}") == 2
    error = capsys.readouterr().err
    assert "has no topic /joint_reaction_force" in error
    topics = "/ground_reaction_force, /implant/force, /joint_states"
    assert f"its topics: {topics}; --remap joint_reaction_force:=" in error
    remap = "--remap joint_reaction_force:=/implant/force"
    assert run(f"calibrate {bag} {options} {remap}") == 0
    found = fitted(
        bag, [TONE], remap={"joint_reaction_force": "/implant/force"}, with_intervals=False
    )
    assert found.values[TONE] > 0.0
    (tmp_path / "left").mkdir()
    bag = trial(tmp_path / "left", 5, namespace="/left")
    assert run(f"calibrate {bag} {options}") == 2
    assert "or --namespace NAME" in capsys.readouterr().err
    assert run(f"calibrate {bag} {options} --namespace left") == 0


def test_an_estimate_of_our_own_is_no_reference(tmp_path, capsys):
    bag = write_sensors(tmp_path / "sensors.mcap", 200)
    loads = tmp_path / "loads.mcap"
    assert run(f"estimate-load {bag} --output {loads}") == 0
    options = f"--free {TONE} --starts 1 --output {tmp_path}/me.yaml"
    assert run(f"calibrate {loads} {options}") == 0
    warning = "has /load_estimate: its /joint_reaction_force is likely an estimate"
    assert warning in capsys.readouterr().err


WHOLE = {EPOCH + STEP * place: 500.0 for place in range(150)}
FREE_ALL = " ".join(f"--free {name}" for name in FREE)
CASES = [
    (None, FREE_ALL, "joint_states; --remap joint_reaction_force:=TOPIC names a measured"),
    (
        {EPOCH - STEP: 500.0, EPOCH - 2 * STEP: 500.0},
        FREE_ALL,
        "no sample can be fitted to the reference (150 without a reference)",
    ),
    (
        {EPOCH: float("nan"), EPOCH + STEP: float("inf")},
        FREE_ALL,
        "no message on /joint_reaction_force can be a reference (2 not_finite)",
    ),
    (
        {EPOCH + STEP: 500.0},
        FREE_ALL,
        "1 values can be fitted, for 3 parameters; more are needed than parameters are free",
    ),
    (WHOLE, "--free person.ton", "trial.mcap; did you mean person.tone?"),
    (WHOLE, "--free contact.stiffness", "it is not a parameter that can be fitted to bag"),
    (WHOLE, "", "Missing option '--free'"),
    (
        WHOLE,
        f"--free {TONE} --params healthy",
        "no parameters for node knee_load; found /**/knee_contact",
    ),
    (
        WHOLE,
        f"--free {TONE} -p person.ton:=1",
        "unknown parameter person.ton; did you mean person.tone?",
    ),
    (WHOLE, f"--free {TONE} -p knee.joint_name:=kne", "joint_states has no joint 'kne'; it has"),
    (WHOLE, f"--free {TONE} --remap force:=/x", "FROM must be joint_states or ground_reaction_f"),
]


@pytest.mark.parametrize(("reference", "options", "reason"), CASES)
def test_wrong_bags_and_options_are_one_line(
    tmp_path,
    capsys,
    reference,
    options,
    reason,
):
    bag = write_sensors(tmp_path / "trial.mcap", 150, reference)
    assert run(f"calibrate {bag} --output {tmp_path}/me.yaml {options}") == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert reason in line
    assert list(tmp_path.iterdir()) == [bag]


def test_python_names_its_argument(tmp_path):
    bag = write_sensors(tmp_path / "trial.mcap", 150, WHOLE)
    with pytest.raises(UsageError, match=r"^free person\.ton: it is not a parameter"):
        calibrate(bag, None, ["person.ton"])
