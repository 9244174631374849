"""From an implant's measurements to a table: what is found again, what it is worth, and what is refused."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from knee_contact_ros.commands.main import main
from knee_contact_ros.joint_reaction.compartments import MeasuredShare, ShareTable
from knee_contact_ros.lab.shares import Curve, Trial, chosen, fit_curve, fit_table
from knee_contact_ros.parameters.files import read_share_table

WEIGHT = 700.0
TRUE = ShareTable(
    np.radians([-10.0, 0.0, 10.0, 20.0, 40.0, 70.0]),
    np.array([0.0, 0.6, 1.2, 1.8, 2.4]),
    0.5 + 0.4 * np.sin(np.arange(30.0)).reshape(6, 5),
)
SUMS = [
    "--axial",
    "am + pm + lateral",
    "--medial",
    "am+pm",
    "--flexion=-angle",
    "--angle-unit",
    "deg",
]
CELLS = "1.0 * pm_n + am_n + al_n + pl_n", "0.9871 am_n + 0.9683 pm_n + 0.0387 al_n + 0.0211 pl_n"


APART = 0.08
"""Spacing [m] of the compartments of the knee that is drawn"""


def drawn(seed: int, number: int = 4000, table: ShareTable = TRUE, noise: float = 0.0) -> Trial:
    """A trial of a knee whose shares are those of a table, all over it, and whose moments balance them."""
    random = np.random.default_rng(seed)
    flexion, load = (
        np.radians(random.uniform(-10.0, 70.0, number)),
        random.uniform(0.0, 2.4, number),
    )
    medial = MeasuredShare(table, 1.0).share(load, flexion) * load + random.normal(
        0.0, noise, number
    )
    return Trial(f"drawn{seed}", flexion, load, medial, APART * (0.5 * load - medial), WEIGHT)


def written(
    folder: Path, trial: Trial, step: float = 1.0, gap: slice = slice(0)
) -> tuple[Path, Path]:
    """Its files: cells every `step` [s], and angles, except the rows of a `gap`."""
    cells, angles = folder / f"{trial.name}.csv", folder / f"{trial.name}_angle.csv"
    time = step * np.arange(len(trial.load))
    force = WEIGHT * np.column_stack(
        (0.25 * trial.medial, 0.75 * trial.medial, trial.load - trial.medial, trial.moment)
    )
    np.savetxt(
        cells,
        np.column_stack((time, force)),
        delimiter=",",
        header="time_s,am,pm,lateral,mx",
        comments="",
    )
    degrees = np.column_stack((time, -np.degrees(trial.flexion)))
    np.savetxt(
        angles,
        np.delete(degrees, gap, axis=0),
        delimiter=",",
        header="time_s,angle",
        comments="# of a model\n",
    )
    return cells, angles


def test_a_table_is_found_again() -> None:
    found = fit_table([drawn(1), drawn(2)], smoothing=1e-12)
    np.testing.assert_array_equal(found.flexion, TRUE.flexion)
    np.testing.assert_array_equal(found.load, TRUE.load)
    loaded = TRUE.load > 0.0  # without a load the share divides nothing
    np.testing.assert_allclose(found.share[:, loaded], TRUE.share[:, loaded], atol=1e-5)


def test_shares_stay_within_their_bounds_and_neighbours_say_what_is_where_no_trial_has_been() -> (
    None
):
    trial = drawn(4)
    pulled = trial._replace(medial=np.where(trial.flexion > 0.5, -0.05, 1.05) * trial.load)
    share = fit_table([pulled], 1e-3).share
    assert (share.min(), share.max()) == (0.0, 1.0)
    seen = (trial.load < 1.2) | (trial.flexion < 0.3)
    share = fit_table(
        [Trial("part", *(column[seen] for column in trial[1:5]), WEIGHT)], 1e-3
    ).share
    assert share[-1, -1] == pytest.approx(0.5 * (share[-2, -1] + share[-1, -2]), abs=1e-6)


SMOOTH = Curve(0.7, 0.8)


def test_a_curve_is_found_again_and_noise_is_not_fitted() -> None:
    """Shares of a curve with noise: the table over flexion would follow that, and is refused."""
    trials = [drawn(seed, 120, SMOOTH.table, 0.1) for seed in (1, 2, 3)]
    assert fit_curve([drawn(1, 500, SMOOTH.table)]) == pytest.approx(
        SMOOTH, rel=0.01
    )  # a step is 0.1 BW
    found = chosen(trials, "auto")
    assert found.curve == pytest.approx(SMOOTH, rel=0.15)
    assert found.table.share[0].tolist() == found.table.share[1].tolist()
    assert np.mean(found.errors["table"]) > np.mean(found.errors["curve"])
    alone = chosen(trials[:1], "auto")
    assert alone.curve is not None
    assert alone.errors["curve"] == pytest.approx([0.1], abs=0.03)  # of its quarters
    follows = chosen([drawn(1, 500), drawn(2, 500)], "auto")
    assert follows.curve is None
    assert follows.smoothing < 1e-3
    assert chosen([drawn(1, 500), drawn(2, 500)], "curve").curve is not None


def run(*arguments: object) -> int:
    return main(["fit-share", *map(str, arguments)])


def test_the_command_writes_a_table_and_its_source(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    trials = [f"--trial={','.join(map(str, written(tmp_path, drawn(seed))))}" for seed in (1, 2)]
    output = tmp_path / "share.csv"
    source = ("--source", "somebody\nelse")
    arguments = (
        *trials,
        *SUMS,
        "--moment=mx",
        "--body-weight",
        WEIGHT,
        *source,
        "--output",
        output,
    )
    assert run(*arguments) == 0
    said = capsys.readouterr().out
    assert "drawn2" in said
    assert "Fitted to all: a table, smoothing" in said
    assert "load.compartment_spacing: 0.0800" in said
    text = output.read_text(encoding="utf-8")
    assert "# Source: somebody\n# Source: else\n" in text
    table = read_share_table("share.csv", text)
    assert np.abs(table.share - TRUE.share)[:, 2:].max() < 0.01  # smoothed
    turned = ["--moment=-mx" if each == "--moment=mx" else each for each in arguments]
    assert run(*turned, "--overwrite") == 0
    assert "a spacing of -0.08 m fits no knee: look at the sign" in capsys.readouterr().err
    assert run(trials[0], *arguments, "--overwrite") == 2
    assert "trials drawn1 and drawn1 are the same" in capsys.readouterr().err
    assert run(*arguments) == 2
    assert "exists already" in capsys.readouterr().err
    assert run(*arguments, "--overwrite") == 0


def test_what_lies_in_a_gap_of_another_file_is_left_out(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    files = written(tmp_path, drawn(1, 1000), 0.01, gap=slice(300, 700))
    trial = f"--trial={','.join(map(str, files))}"
    assert run(trial, *SUMS, "--body-weight", WEIGHT, "--output", tmp_path / "a.csv") == 0
    assert (
        "trial drawn1: 400 of 1000 samples left out, as they lie in gaps longer than 0.1 s"
        in capsys.readouterr().err
    )


WRONG_OPTIONS = [
    (
        ["--axial", "am + nothing"],
        "--axial: trial drawn1 has no column nothing; it has time_s, am, pm, lateral, mx",
    ),
    (["--axial", "am pm"], "'am pm': it must be a sum of columns"),
    (["--angle-unit", "rad"], "--angle-unit deg, if it is in degrees"),
    (["--flexion=-0.01745 angle"], "flexion moves by 1.3"),
    (
        ["--axial", "9.81 am + 9.81 pm + 9.81 lateral"],
        "reaches 23.5 body weights, and a knee that bears its body 0.75 to 8: are both",
    ),
    (["--flexion", "angle"], "it must be positive in flexion: change the sign"),
    (["--axial", "-am - pm - lateral"], "the axial force reaches"),
    (["--medial", "am + pm + lateral + lateral"], "beyond 0 or the whole"),
    (["--time", "t"], "has no column t; it has"),
    (
        ["--body-weight", "600", "--body-weight", "600"],
        "3 for 1 trials; give one, or one for each",
    ),
    (["--trial", "none.csv"], "cannot read none.csv"),
    (["--moment", "0*mx"], "--moment is 0 throughout"),
    (["--moment", "1000 mx"], "of the samples: is it in N m?"),
]
ANGLE_ROWS = "".join(f"{n},{-n % 60}\n" for n in range(100))
DAMAGED_FILES = [
    (
        f"time_s,angle\ns,rad\n{ANGLE_ROWS}",
        "says rad of column angle, and --flexion must be in deg",
    ),
    (f"time_s,angle\nms,deg\n{ANGLE_ROWS}", "says ms of column time_s, and time.unit s"),
    (
        "time_s,angle\n0,1\n1,2\n2,4\n99,1\n",
        "4 samples at which all files have some; at least 20 are needed; ",
    ),
    ("", "is empty"),
    ("time_s,angle\n0,1\n1,b\n", "line 3, column angle: 'b' is not a number"),
    ("time_s,angle\n0,1\n0,1\n", "column time_s has the value of the next row"),
    (
        "time_s,angle\n0,1\n1,nan\n2,3\n99,1\n",
        "column angle of trial drawn1 has values that are not numbers",
    ),
    ("time_s,angle\n1000,1\n1001,2\n", "trial drawn1: 0 samples at which all files have some"),
    ("time_s,angle,am\n0,1,1\n99,1,1\n", "column am is in another file of trial drawn1, too"),
]


@pytest.mark.parametrize(
    ("arguments", "content", "reason"),
    [(options, None, reason) for options, reason in WRONG_OPTIONS]
    + [([], *case) for case in DAMAGED_FILES],
)
def test_what_is_wrong_is_told_in_one_line(
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    arguments: list[str],
    content: str | None,
    reason: str,
) -> None:
    cells, angles = written(tmp_path, drawn(1, 100))
    if content is not None:
        angles.write_text(content, encoding="utf-8")
    files = (
        "--trial",
        f"{cells},{angles}",
        *SUMS,
        "--body-weight",
        WEIGHT,
        "--output",
        tmp_path / "a.csv",
    )
    assert run(*files, *arguments) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert reason in line
    assert not (tmp_path / "a.csv").exists()


def test_two_instrumented_knees(
    reference_data: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A person's own table holds for the trial that is left out; no share lies beside one that contradicts it."""
    first, second = reference_data / "instrumented_knee", reference_data / "instrumented_knee_ps"
    if not first.is_dir() or not second.is_dir():
        pytest.skip("the measurements of the instrumented knees are not on this machine")
    persons = (
        (first, ("ngait_og5", "ngait_tm_fast1"), "tibia_cells", *CELLS, "654.3", 90.0, 0.071),
        (
            second,
            [f"PS_ngait_og_{name}" for name in ("ss1", "ss8", "ss11")],
            "tibia_force",
            "total_n",
            "medial_n",
            "735.75",
            140.0,
            0.093,
        ),
    )
    for folder, names, forces, axial, medial, weight, missed, apart in persons:
        trials = [
            f"--trial={folder / name}_{forces}.csv,{folder / name}_motion.csv" for name in names
        ]
        output = tmp_path / f"{weight}.csv"
        sums = [
            "--axial",
            axial,
            "--medial",
            medial,
            "--flexion=-knee_flexion_deg",
            "--angle-unit",
            "deg",
        ]
        sums += ["--moment", "knee_adduction_moment_nm"]
        assert run(*trials, *sums, "--body-weight", weight, "--output", output) == 0
        said = capsys.readouterr().out
        left_out = [
            float(line.split(" N")[3].split()[-1])
            for line in said.splitlines()
            if line.count(" N") > 3
        ]
        assert len(left_out) == len(names)
        assert max(left_out) <= missed
        assert float(said.split("load.compartment_spacing: ")[1].split()[0]) == pytest.approx(
            apart, abs=1e-3
        )
        share = read_share_table(output.name, output.read_text(encoding="utf-8")).share
        assert np.abs(np.diff(share, axis=0)).max() < 0.4
        assert np.abs(np.diff(share, axis=1)).max() < 0.4
