"""`knee-contact report` as a person runs it: files, numbers and page; bad input, damaged bags and interruption."""

from __future__ import annotations

import base64
import io
import math
import re
from pathlib import Path

import numpy as np
import pytest

from knee_contact_ros import load_model
from knee_contact_ros.bags.answers import read_answers
from knee_contact_ros.bags.recorder import BagWriter
from knee_contact_ros.commands.main import main
from knee_contact_ros.lab.report.figures import OF_MEDIAL, TOTAL
from knee_contact_ros.lab.report.gathered import (
    CYCLE_CURVES,
    CYCLE_PERCENT,
    EVENT_COLUMNS,
    PEAK_COLUMNS,
    STRIDE_COLUMNS,
)
from knee_contact_ros.model.readouts import SPREAD
from knee_contact_ros.model.types import FLAT
from knee_contact_ros.offline.solve import solve
from knee_contact_ros.parameters.files import load_parameters
from knee_contact_ros.streams.topics import EACH_TICK, KNEE_CONTACT_WRENCH, MESSAGE_TYPES
from knee_contact_ros.view.picture import png_figure
from tests.helpers.bags import raw_messages
from tests.lab.report.pages import check_html, numbers, page_of, rows_of, runs_of, text_of
from tests.offline.test_solve import make_bag

pytest.importorskip(
    "matplotlib", minversion="3.7", reason="needs the extra report: matplotlib 3.7"
)

BODY_WEIGHT = 737.068
CYCLE_FIGURES = [
    "contact_force.png",
    "depth.png",
    "flexion.png",
    "peak_pressure.png",
    "patch_half_width.png",
]
MOVING_FIGURES = ["contact_point.png"]
TABLES = {"cycles.csv", "events.csv", "peaks.csv", "strides.csv"}
RUNS = ["right", "right, osteoarthritis", "left", "left, osteoarthritis"]
LABEL = '_<b onload="x">&$\\no$'
PNG = b"\x89PNG\r\n\x1a\n"


@pytest.fixture(scope="module")
def both(tmp_path_factory: pytest.TempPathFactory, bags: tuple[Path, Path]) -> Path:
    """Both knees, healthy beside osteoarthritic."""
    output = tmp_path_factory.mktemp("report") / "both"
    arguments = [
        "--label",
        "right",
        "--label",
        "left",
        "--compare",
        "osteoarthritis.yaml",
        "--output",
        str(output),
    ]
    assert main(["report", *map(str, bags), *arguments]) == 0
    return output


@pytest.fixture(scope="module")
def moving(tmp_path_factory: pytest.TempPathFactory, bags: tuple[Path, Path]) -> Path:
    """One knee with a femur from MRI under the total load, under a label that is none of HTML."""
    output = tmp_path_factory.mktemp("report") / "moving"
    arguments = [
        "--params",
        "healthy.yaml",
        "--params",
        "mri_femur.yaml",
        "-p",
        "load.compartment:=total",
    ]
    assert (
        main(["report", str(bags[0]), *arguments, "--label", LABEL, "--output", str(output)]) == 0
    )
    return output


def test_all_files_are_there_and_nothing_is_cut_at_the_figures_edges(both: Path) -> None:
    from PIL import Image

    figures = ["knee_1.png", "knee_2.png", *CYCLE_FIGURES, "over_time_1.png", "over_time_2.png"]
    assert {path.name for path in both.iterdir()} == {
        "report.html",
        *figures,
        *TABLES,
    }  # a circle's contact stays
    for name in figures:
        assert (both / name).read_bytes().startswith(PNG)
        with Image.open(both / name) as image:
            pixels = np.asarray(image.convert("L"))
        for edge in (pixels[0], pixels[-1], pixels[:, 0], pixels[:, -1]):
            assert edge.min() == 255, name
    page = page_of(both)
    check_html(page)
    references = re.findall(r"""(?:src|href|action|poster|data)\s*=\s*["']([^"']*)""", page)
    assert len(references) == 10  # nine pictures and an empty icon
    assert all(each.startswith("data:") for each in references)
    assert not re.search(r"https?://|@import|url\((?!data:)", page)
    pictures = re.findall(r'src="data:image/png;base64,([^"]+)"', page)
    assert [base64.b64decode(each) for each in pictures] == [
        (both / name).read_bytes() for name in figures
    ]


def test_letters_that_the_font_lacks_cause_no_warnings(recwarn: pytest.WarningsRecorder) -> None:
    with png_figure(io.BytesIO(), (1.0, 1.0), 50) as figure:
        figure.text(0.0, 0.0, "右\x1b")
    assert not recwarn.list


def test_curves_are_those_of_the_answers_and_strides_are_written(
    both: Path, recording: Path
) -> None:
    rows = runs_of(both / "cycles.csv")[RUNS[1]]
    assert numbers(rows, "gait_cycle_percent") == pytest.approx(CYCLE_PERCENT)
    assert {row["cycles"] for row in rows} == {"1"}
    events = runs_of(both / "events.csv")[RUNS[1]]
    strikes = [float(row["stamp_s"]) for row in events if row["event"] == "heel strike"]
    answers = read_answers(recording)
    read_off = load_model("osteoarthritis").readouts(answers)
    at = strikes[0] + (strikes[1] - strikes[0]) * CYCLE_PERCENT / 100.0
    units = {
        "deg": np.degrees(1.0),
        "mm": 1e3,
        "s": 1e3,
        "N": 1.0,
        "MPa": 1e-6,
        "percent": 100.0,
        "BW": 1.0 / BODY_WEIGHT,
    }
    for name, (field, *_) in CYCLE_CURVES.items():
        values = read_off[field] if field in SPREAD else answers.view(FLAT)[field]
        expected = np.interp(at, answers["stamp"] / 1e9, values) * units[name.rsplit("_", 1)[1]]
        # Nine digits in the file; stamps are rounded to 1 ns, of a course of at most 1 BW in 10 ms
        assert numbers(rows, f"{name}_mean") == pytest.approx(expected, rel=1e-6, abs=1e-6)
        assert {row[f"{name}_sd"] for row in rows} == {""}  # of a single cycle there is none
    assert list(rows[0]) == [
        "run",
        "gait_cycle_percent",
        "cycles",
        *(f"{name}_{kind}" for name in CYCLE_CURVES for kind in ("mean", "sd")),
    ]
    strides = runs_of(both / "strides.csv")
    assert list(strides) == RUNS
    (row,) = strides[RUNS[1]]
    assert tuple(row) == ("run", "cycle", *STRIDE_COLUMNS)
    assert f"sliding distance [mm] {float(row['sliding_distance_mm']):.1f}" in text_of(both)


def test_peaks_and_events_are_those_of_the_demo(both: Path) -> None:
    runs = runs_of(both / "peaks.csv")
    assert list(runs) == RUNS
    right = runs[RUNS[0]]
    assert tuple(right[0]) == ("run", *PEAK_COLUMNS)
    assert [row["stamp_s"] for row in right] == [
        "0.785000000",
        "1.205000000",
        "2.015000000",
        "2.430000000",
    ]
    assert [(row["peak"], row["cycle"]) for row in right] == [
        ("first", "1"),
        ("second", "1"),
        ("", ""),
        ("", ""),
    ]
    assert numbers(right, "time_s") == pytest.approx([0.255, 0.675, 1.485, 1.900], abs=1e-9)
    assert numbers(right, "load_N") == pytest.approx(
        [1265.2, 1556.9, 1337.7, 1613.8], abs=0.05
    )  # the demo's digits
    assert numbers(right, "contact_force_N") == pytest.approx(
        [1265.6, 1557.1, 1338.0, 1614.1], abs=0.05
    )
    assert numbers(right, "penetration_depth_mm") == pytest.approx(
        [0.635, 0.729, 0.658, 0.747], abs=0.0005
    )
    assert numbers(right[:2], "gait_cycle_percent") == pytest.approx([13.2, 47.3], abs=0.05)
    left = runs_of(both / "events.csv")["left"]
    assert tuple(left[0]) == ("run", *EVENT_COLUMNS)
    kinds = [
        "load peak",
        "toe-off",
        "heel strike",
        "load peak",
        "load peak",
        "toe-off",
        "heel strike",
    ]
    assert [row["event"] for row in left] == kinds
    assert numbers(left, "stamp_s") == pytest.approx(numbers(left, "time_s") + 0.53, abs=1e-8)
    assert left[0]["text"] == "load peak 2.56 BW (1884.2 N)"
    assert float(left[0]["penetration_depth_mm"]) == pytest.approx(0.827, abs=0.0005)
    for rows in (right, left):
        for kind in ("load", "contact_force"):
            assert numbers(rows, f"{kind}_BW") == pytest.approx(
                numbers(rows, f"{kind}_N") / BODY_WEIGHT, rel=1e-8
            )


def test_a_recording_from_before_sliding_and_force_error(
    old_recording: Path, tmp_path: Path
) -> None:
    out = tmp_path / "out"
    assert (
        main(
            [
                "report",
                str(old_recording),
                "--compare",
                "osteoarthritis.yaml",
                "--output",
                str(out),
            ]
        )
        == 0
    )
    assert "error bound of the contact force not in this recording" in text_of(out)
    old, compared = rows_of(out / "strides.csv")
    assert old["sliding_distance_mm"] == old["largest_sliding_velocity_mm_per_s"] == ""
    assert float(compared["sliding_distance_mm"]) > 30.0  # computed now
    assert float(old["largest_penetration_depth_mm"]) == pytest.approx(0.729, abs=0.0005)
    for row in rows_of(out / "peaks.csv")[:4]:
        assert row["contact_force_error_N"] == ""
        assert 0.0 < float(row["penetration_depth_error_mm"]) < 1e-3
    curves = rows_of(out / "cycles.csv")[0]
    assert curves["sliding_velocity_mm_per_s_mean"] == ""
    assert curves["contact_force_N_mean"]


def test_the_page_says_what_it_should(both: Path, moving: Path) -> None:
    text = text_of(both)
    for words in (
        "Knee contact: right, left",
        "not of a medical device",
        "medial compartment: 0.5 of the axial joint reaction",
        "doi:10.1186/ar4138",
        "387 in 1.93 s (200 Hz)",
        "0.915 s (47.4 %)",
        "the contact law has one layer",
        "ticks not converged",
        "impulse of stance [BW s]",
        "1.084",
        "contact.layer_depth",
        "except for the contact law of osteoarthritis.yaml",
        "The contact point does not move",
        "Grey, published of the medial compartment:",
        "The largest load of right, at 2.430 s, is not within a whole gait cycle.",
    ):
        assert words in text
    assert "What makes no sense" not in text
    for words in (
        "contact.law: kelvin_voigt → two_layer_viscoelastic",
        "contact.layer_depth: – → 0.0005 m",
    ):
        assert text.count(words) == 1
    peaks = text.partition("Peaks")[2].partition("What differs")[0]
    # As `solve` prints them for the right and the left leg, and with the other law; in whole cycles they are smaller.
    for row in (
        "largest contact force [BW] 2.19 2.19 3.03",
        "largest depth [mm] 0.747 0.538 0.929",
        "second peak: contact force [BW] 2.11 2.11 3.03",
    ):
        assert row in peaks
    # Another load has other published ranges, and a femur from MRI a contact point that moves.
    check_html(page_of(moving))
    text = text_of(moving)
    assert "total: the whole axial joint reaction" in text
    assert TOTAL[0].text in text
    assert OF_MEDIAL[0].text not in text
    assert "<b onload" not in page_of(moving)
    assert "&lt;b onload=" in page_of(moving)
    assert {path.name for path in moving.iterdir()} >= {*MOVING_FIGURES}
    assert np.ptp(numbers(rows_of(moving / "cycles.csv"), "contact_point_x_mm_mean")) > 5.0


def test_a_recording_says_its_parameters_itself(recording: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    assert main(["report", str(recording), "--compare", "healthy.yaml", "--output", str(out)]) == 0
    text = text_of(out)
    assert "Recorded with knee_contact_ros" in text
    assert "body_weight: 700 instead of 737.068 N" in text  # stored, and not that of healthy.yaml
    runs = runs_of(out / "peaks.csv")
    assert float(runs["knee, healthy"][1]["penetration_depth_mm"]) == pytest.approx(
        0.729, abs=0.0005
    )
    for rows in runs.values():  # healthy.yaml says 737.068 N, and a comparison is no other person
        assert float(rows[1]["load_BW"]) == pytest.approx(
            float(rows[1]["load_N"]) / 700.0, rel=1e-8
        )
    assert "body_weight 700 (not 737.068)" in text


def test_recordings_of_others_and_of_two_knees_in_one(recording: Path, tmp_path: Path) -> None:
    """Somebody else's recorder stores the messages, and no parameters."""
    path, out = tmp_path / "both.mcap", tmp_path / "out"
    types = {
        f"/{topic}": MESSAGE_TYPES[topic] for topic in EACH_TICK if topic != KNEE_CONTACT_WRENCH
    }
    with BagWriter(path) as bag:
        for side in ("left", "right"):
            for topic, name in types.items():
                bag.add_topic(f"/{side}{topic}", name)
        for message in raw_messages(recording, types):
            for side in ("left", "right"):
                bag.write_message(f"/{side}{message.topic}", message.log_time, message.data)
    assert main(["report", str(path), "--compare", "healthy.yaml", "--output", str(out)]) == 0
    runs = runs_of(out / "peaks.csv")
    assert list(runs) == [
        f"both {side}/knee_contact{name}"
        for side in ("left", "right")
        for name in ("", ", healthy")
    ]
    depths = [numbers(rows, "penetration_depth_mm").max() for rows in runs.values()]
    assert depths == pytest.approx([0.538, 0.747] * 2, abs=0.0005)
    assert "contact.law: not known → kelvin_voigt" in text_of(out)
    assert not list(out.glob("knee_*.png"))  # of surfaces that nobody knows
    assert (
        "Recorded without its parameters; healthy.yaml is taken for body weight and law."
        in text_of(out)
    )
    assert (
        main(
            ["report", str(path), "-p", "body_weight:=600.0", "--output", str(tmp_path / "again")]
        )
        == 0
    )
    assert not (tmp_path / "again" / "peak_pressure.png").exists()  # of a law that nobody knows
    row = rows_of(tmp_path / "again" / "peaks.csv")[0]
    assert float(row["load_BW"]) == pytest.approx(float(row["load_N"]) / 600.0, rel=1e-8)


def test_without_gait_everything_is_over_time_and_an_earlier_report_gives_way(
    tmp_path: Path,
) -> None:
    bag, out = (
        make_bag(tmp_path / "standing.mcap", [(i * 5_000_000, 0.1, 800.0) for i in range(400)]),
        tmp_path / "out",
    )
    out.mkdir()
    earlier = [
        "over_time_1.png",
        "over_time_7.png",
        "knee_2.png",
        "uncertainty.csv",
        "uncertainty_1.png",
    ]
    for name in ("mine.txt", "report.html", *earlier, *CYCLE_FIGURES, *MOVING_FIGURES, *TABLES):
        (out / name).write_text("earlier")
    assert main(["report", str(bag), "--output", str(out)]) == 0
    assert {path.name for path in out.iterdir()} == {
        "report.html",
        "knee_1.png",
        "over_time_1.png",
        "mine.txt",
        *TABLES,
    }
    assert (out / "mine.txt").read_text() == "earlier"
    assert (out / "over_time_1.png").read_bytes().startswith(PNG)
    assert "No two successive heel strikes" in text_of(out)
    assert rows_of(out / "cycles.csv") == rows_of(out / "peaks.csv") == []


@pytest.mark.filterwarnings("error::UserWarning")
def test_what_makes_no_sense_stands_first(bags: tuple[Path, Path], tmp_path: Path) -> None:
    """Solved for the report, and as a recording says it itself."""
    recording, out = tmp_path / "knee.mcap", tmp_path / "out"
    solve(bags[0], load_parameters({"contact.stiffness": 2500.0}), recording)
    pulled = make_bag(
        tmp_path / "pulled.mcap", [(i * 10_000_000, 0.1, -800.0) for i in range(121)]
    )
    assert main(["report", str(recording), str(pulled), "--output", str(out)]) == 0
    check_html(page_of(out))
    told = text_of(out).partition("What makes no sense.")[2].partition("Peaks")[0]
    for words in (
        "knee: contact.stiffness 2500 N/m^1.5 gives 279 mm of depth under 368.5 N",
        "knee: 387 of 387 ticks are up to 359 mm deep, beyond 6.8 mm, a fifth of the femoral radius",
        "pulled: the load was negative throughout (-400 to -400 N)",
    ):
        assert told.count(words) == 1


def test_where_the_height_drives_a_report_is_of_the_contact_force(tmp_path: Path) -> None:
    rows, out = [(i * 5_000_000, 0.1, 800.0) for i in range(100)], tmp_path / "out"
    bag = make_bag(
        tmp_path / "pressed.mcap",
        rows,
        heights=0.0335 - 3e-4 * np.sin(0.05 * np.arange(100.0)) ** 2,
    )
    solve(bag, load_parameters({"drive": "displacement"}), tmp_path / "height.mcap")
    (tmp_path / "sd.yaml").write_text("contact.stiffness: 20 %\n")
    asked = [
        "report",
        str(tmp_path / "height.mcap"),
        "--uncertainty",
        str(tmp_path / "sd.yaml"),
        "--output",
        str(out),
    ]
    assert main(asked) == 0
    assert "At the largest contact force, with sign" in text_of(out)
    force = read_answers(tmp_path / "height.mcap")["contact_force"].max()
    stiffer = float(rows_of(out / "uncertainty.csv")[0]["force_at_largest_load_N"])
    assert stiffer == pytest.approx(
        math.sinh(0.2) * force, rel=0.05
    )  # all but what the dashpot bears
    assert f"largest contact force [BW] {force / BODY_WEIGHT:.2f}" in text_of(out)
    assert "The femoral height is prescribed (height)" in text_of(out)
    assert "largest load [" not in text_of(out)
    assert "contact force answers the load" not in text_of(out)


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["nowhere.mcap"], "no bag at nowhere.mcap"),
        (["{bag}", "--label", "a", "--label", "b"], "--label: 2 given for 1 FILEs"),
        (["{bag}", "--compare", "mri_femur.yaml"], "mri_femur.yaml: sets no contact.* parameter"),
        (["{bag}", "--uncertainty", "{wrong}"], "uncertainty: contact.stifness is not allowed"),
        (["{recording}", "--params", "healthy.yaml"], "--params is for bags"),
        (["{csv}"], "femur_medial.csv"),
    ],
)
def test_bad_input_is_told_in_a_line(
    arguments, words, bags, recording: Path, config: Path, tmp_path: Path, capsys
) -> None:
    (tmp_path / "wrong.yaml").write_text("contact.stifness: 20 %\n")
    names = {
        "bag": bags[0],
        "recording": recording,
        "csv": config / "femur_medial.csv",
        "wrong": tmp_path / "wrong.yaml",
    }
    assert (
        main(
            [
                "report",
                *(each.format(**names) for each in arguments),
                "--output",
                str(tmp_path / "out"),
            ]
        )
        == 2
    )
    error = capsys.readouterr().err
    assert words in error
    assert error.count("\n") == 1
    assert not (tmp_path / "out").exists()


def test_a_damaged_bag_is_told_and_reported_as_far_as_it_goes(
    bags, tmp_path: Path, capsys
) -> None:
    source = next(bags[0].glob("*.mcap"))
    cut = tmp_path / "cut.mcap"
    cut.write_bytes(source.read_bytes()[: source.stat().st_size * 2 // 3])
    assert main(["report", str(cut), "--output", str(tmp_path / "out")]) == 1
    assert capsys.readouterr().err.count("\n") == 1
    assert "The file is damaged" in text_of(tmp_path / "out")
