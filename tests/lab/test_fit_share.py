"""From an implant's measurements to a table: what is found again, what it is worth, and what is refused."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from knee_contact_ros.commands.main import main
from knee_contact_ros.joint_reaction.compartments import MeasuredShare, ShareTable
from knee_contact_ros.lab.shares import Trial, constant, errors, fit
from knee_contact_ros.parameters.files import read_share_table

WEIGHT = 700.0
TRUE = ShareTable(
    np.radians([-10.0, 0.0, 10.0, 20.0, 40.0, 70.0]), np.array([0.0, 0.6, 1.2, 1.8, 2.4]),
    0.5 + 0.4 * np.sin(np.arange(30.0)).reshape(6, 5),
)  # fmt: skip
SUMS = ["--axial", "am + pm + lateral", "--medial", "am+pm", "--flexion=-angle", "--angle-unit", "deg"]
CELLS = "1.0 * pm_n + am_n + al_n + pl_n", "0.9871 am_n + 0.9683 pm_n + 0.0387 al_n + 0.0211 pl_n"


def drawn(seed: int, number: int = 4000) -> Trial:
    """A trial of a knee whose shares are those of a table, all over it."""
    random = np.random.default_rng(seed)
    flexion, load = np.radians(random.uniform(-10.0, 70.0, number)), random.uniform(0.0, 2.4, number)
    return Trial(f"drawn{seed}", flexion, load, MeasuredShare(TRUE, 1.0).share(load, flexion) * load, WEIGHT)


def written(folder: Path, trial: Trial) -> tuple[Path, Path]:
    """Its files: cells, and angles at other times."""
    cells, angles, time = folder / f"{trial.name}.csv", folder / f"{trial.name}_angle.csv", np.arange(len(trial.load))
    force = WEIGHT * np.column_stack((0.25 * trial.medial, 0.75 * trial.medial, trial.load - trial.medial))
    np.savetxt(cells, np.column_stack((time, force)), delimiter=",", header="time_s,am,pm,lateral", comments="")
    degrees = np.column_stack((time, -np.degrees(trial.flexion)))
    np.savetxt(angles, degrees, delimiter=",", header="time_s,angle", comments="# of a model\n")
    return cells, angles


def test_a_table_is_found_again() -> None:
    found = fit([drawn(1), drawn(2)], smoothing=1e-12)
    np.testing.assert_array_equal(found.flexion, TRUE.flexion)
    np.testing.assert_array_equal(found.load, TRUE.load)
    loaded = TRUE.load > 0.0  # without a load the share divides nothing
    np.testing.assert_allclose(found.share[:, loaded], TRUE.share[:, loaded], atol=1e-5)


def test_the_smoothest_table_is_the_best_constant_and_a_long_trial_weighs_no_more() -> None:
    trials = [drawn(1, 100), drawn(2, 4000)]
    assert np.ptp(fit(trials, smoothing=1e6).share) < 1e-4
    assert fit(trials, smoothing=1e6).share[0, 0] == pytest.approx(constant(trials), abs=1e-4)
    doubled = Trial("twice", *(np.concatenate((column, column)) for column in trials[1][1:4]), WEIGHT)
    np.testing.assert_allclose(fit([trials[0], doubled]).share, fit(trials).share, atol=1e-9)


def test_shares_stay_within_their_bounds_and_neighbours_say_what_is_where_no_trial_has_been() -> None:
    trial = drawn(4)
    pulled = trial._replace(medial=np.where(trial.flexion > 0.5, -0.05, 1.05) * trial.load)
    share = fit([pulled]).share
    assert (share.min(), share.max()) == (0.0, 1.0)
    seen = (trial.load < 1.2) | (trial.flexion < 0.3)
    share = fit([Trial("part", *(column[seen] for column in trial[1:4]), WEIGHT)]).share
    assert share[-1, -1] == pytest.approx(0.5 * (share[-2, -1] + share[-1, -2]), abs=1e-6)


def test_a_trial_that_is_left_out_does_not_count() -> None:
    one, two = drawn(5), drawn(6)
    other = two._replace(medial=0.9 * two.load)
    found = errors([one, other], 1e-3, fit([one, other]))
    expected = WEIGHT * np.sqrt(np.mean((one.medial - 0.9 * one.load) ** 2))
    assert (found[0].constant, found[0].left_out) == pytest.approx((expected, expected), rel=1e-3)
    assert np.isnan(errors([one], 1e-3, fit([one]))[0].left_out)


def run(*arguments: object) -> int:
    return main(["fit-share", *map(str, arguments)])


def test_the_command_writes_a_table_and_its_source(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    trials = [f"--trial={','.join(map(str, written(tmp_path, drawn(seed))))}" for seed in (1, 2)]
    output = tmp_path / "share.csv"
    arguments = (*trials, *SUMS, "--body-weight", WEIGHT, "--source", "somebody\nelse", "--output", output)
    assert run(*arguments) == 0
    said = capsys.readouterr().out
    assert "constant of" in said and "drawn2" in said  # noqa: PT018
    text = output.read_text(encoding="utf-8")
    assert "# Source: somebody\n# Source: else\n" in text
    table = read_share_table("share.csv", text)
    assert np.abs(table.share - TRUE.share)[:, 2:].max() < 0.05  # smoothed
    assert run(*arguments) == 2
    assert "exists already" in capsys.readouterr().err
    assert run(*arguments, "--overwrite") == 0


WRONG_OPTIONS = [
    (["--axial", "am + nothing"], "--axial: trial drawn1 has no column nothing; it has time_s, am, pm, lateral"),
    (["--axial", "am pm"], "'am pm': it must be a sum of columns"),
    (["--axial", "am + (pm)"], "it must be a sum of columns"),
    (["--axial", ""], "it must be a sum of columns"),
    (["--angle-unit", "rad"], "--angle-unit deg, if it is in degrees"),
    (["--flexion=-0.01745 angle"], "flexion moves by 1.3"),
    (["--axial", "9.81 am + 9.81 pm + 9.81 lateral"],
     "reaches 23.5 body weights, and a knee that bears its body 0.75 to 8: are both"),
    (["--axial", "0.2248 am + 0.2248 pm + 0.2248 lateral"], "reaches 0.539 body weights"),
    (["--flexion", "angle"], "it must be positive in flexion: turn the sign"),
    (["--axial", "-am - pm - lateral"], "the axial force reaches"),
    (["--medial", "am + pm + lateral + lateral"], "beyond 0 or the whole"),
    (["--time", "t"], "has no column t; it has"),
    (["--body-weight", "600", "--body-weight", "600"], "3 for 1 trials; give one, or one for each"),
    (["--trial", "none.csv"], "cannot read none.csv"),
]  # fmt: skip
DAMAGED_FILES = [
    ("", "is empty"),
    ("time_s,angle\n0,1\n1,b\n", "line 3, column angle: 'b' is no number"),
    ("time_s,angle\n0,1\n0,1\n", "column time_s has the value of the next row"),
    ("time_s,angle\n0,1\n1,nan\n2,3\n99,1\n", "column angle of trial drawn1 has values that are no numbers"),
    ("time_s,angle\n1000,1\n1001,2\n", "trial drawn1: 0 samples at which all files have some"),
    ("time_s,angle,am\n0,1,1\n99,1,1\n", "column am is in another file of trial drawn1, too"),
]


@pytest.mark.parametrize(
    ("arguments", "content", "reason"),
    [(options, None, reason) for options, reason in WRONG_OPTIONS] + [([], *case) for case in DAMAGED_FILES],
)
def test_what_is_wrong_is_told_in_one_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], arguments: list[str], content: str | None, reason: str
) -> None:
    cells, angles = written(tmp_path, drawn(1, 100))
    if content is not None:
        angles.write_text(content, encoding="utf-8")
    files = ("--trial", f"{cells},{angles}", *SUMS, "--body-weight", WEIGHT, "--output", tmp_path / "a.csv")
    assert run(*files, *arguments) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert reason in line
    assert not (tmp_path / "a.csv").exists()


def test_an_instrumented_knee(
    reference_data: Path, config: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Fitted on one trial and used on the other; and the shipped table is what the command makes of both."""
    folder, (axial, medial) = reference_data / "instrumented_knee", CELLS
    if not folder.is_dir():
        pytest.skip("the measurements of the instrumented knee are not on this machine")
    both = [
        (folder / f"{name}_tibia_cells.csv", folder / f"{name}_motion.csv") for name in ("ngait_og5", "ngait_tm_fast1")
    ]
    trials = [f"--trial={cells},{motion}" for cells, motion in both]
    output = tmp_path / "share.csv"
    sums = ["--axial", axial, "--medial", medial, "--flexion=-knee_flexion_deg", "--angle-unit", "deg"]
    assert run(*trials, *sums, "--body-weight", "654.3", "--output", output) == 0
    lines = [line for line in capsys.readouterr().out.splitlines() if " N" in line]
    left_out = [float(line.split(" N")[2]) for line in lines]
    assert len(left_out) == 2
    assert max(left_out) <= 90.0  # a quadratic: 93 and 96
    table, kept = (
        read_share_table(path.name, path.read_text(encoding="utf-8")) for path in (output, config / "share_medial.csv")
    )
    np.testing.assert_allclose(table.share, kept.share, atol=2e-4)
