"""`knee-contact report` as a person runs it: files, numbers and page."""

from __future__ import annotations

import base64
import csv
import re
from pathlib import Path

import numpy as np
import pytest

from knee_contact_ros.bags.reader import BagReader
from knee_contact_ros.bags.recorded_answers import read_answers
from knee_contact_ros.bags.writer import BagWriter
from knee_contact_ros.commands.main import main
from knee_contact_ros.model.types import FLAT
from knee_contact_ros.offline.solve import solve
from knee_contact_ros.parameters.build import load_model
from knee_contact_ros.parameters.files import load_parameters
from knee_contact_ros.streams.topics import KNEE_CONTACT_WRENCH, MESSAGE_TYPES, RECORDED
from knee_contact_ros.tools.report.cycles import PERCENT, SPREAD
from knee_contact_ros.tools.report.data import CURVE_COLUMNS, EVENT_COLUMNS, PEAK_COLUMNS, STRIDE_COLUMNS
from knee_contact_ros.tools.report.published import DEPTH, MEDIAL, SOURCES, TOTAL
from tests.offline.test_solve import make_bag, silent
from tests.tools.report.pages import page_of, text_of

pytest.importorskip("matplotlib", minversion="3.7", reason="needs the extra report: matplotlib 3.7")

BODY_WEIGHT = 737.068
CYCLE_FIGURES = {"flexion.png", "contact_force.png", "depth.png", "peak_pressure.png", "patch_half_width.png"}
MOVING_FIGURES = {"contact_point.png", "contact_point_flexion.png"}
KNEES = {"knee_1.png", "knee_2.png"}
TABLES = {"cycles.csv", "events.csv", "peaks.csv", "strides.csv"}
RUNS = {f"{side}, {law}" for side in ("right", "left") for law in ("kelvin_voigt", "two_layer_viscoelastic")}
LABEL = '_<b onload="x">&$\\no$'
PNG = b"\x89PNG\r\n\x1a\n"


@pytest.fixture(scope="module")
def both(tmp_path_factory: pytest.TempPathFactory, bags: tuple[Path, Path]) -> Path:
    """Both knees, healthy beside osteoarthritic."""
    output = tmp_path_factory.mktemp("report") / "both"
    arguments = ["--label", "right", "--label", "left", "--compare", "osteoarthritis.yaml", "--output", str(output)]
    assert main(["report", *map(str, bags), *arguments]) == 0
    return output


@pytest.fixture(scope="module")
def moving(tmp_path_factory: pytest.TempPathFactory, bags: tuple[Path, Path]) -> Path:
    """One knee with a femur from MRI under the total load, under a label that is none of HTML."""
    output = tmp_path_factory.mktemp("report") / "moving"
    arguments = ["--params", "healthy.yaml", "--params", "mri_femur.yaml", "-p", "load.compartment:=total"]
    assert main(["report", str(bags[0]), *arguments, "--label", LABEL, "--output", str(output)]) == 0
    return output


def read(path: Path) -> list[dict[str, str]]:
    with path.open(encoding="utf-8", newline="") as file:
        return list(csv.DictReader(file))


def check_html(page: str) -> None:
    """Raise at the first error of an HTML5 page, where the parser is installed."""
    pytest.importorskip("html5lib", reason="html5lib is not installed (dependency group dev)").HTMLParser(
        strict=True
    ).parse(page)


def numbers(rows: list[dict[str, str]], column: str) -> np.ndarray:
    return np.array([float(row[column]) for row in rows])


def test_all_files_are_there_and_nothing_else(both: Path) -> None:
    expected = {"report.html", "over_time_1.png", "over_time_2.png"} | KNEES | TABLES | CYCLE_FIGURES
    assert {path.name for path in both.iterdir()} == expected  # a circle on a plane: the contact point stays
    for figure in both.glob("*.png"):
        assert figure.read_bytes().startswith(PNG)


def test_nothing_is_cut_at_the_figures_edges(both: Path) -> None:
    from PIL import Image

    for figure in sorted(both.glob("*.png")):
        with Image.open(figure) as image:
            pixels = np.asarray(image.convert("L"))
        for edge in (pixels[0], pixels[-1], pixels[:, 0], pixels[:, -1]):
            assert edge.min() == 255, figure.name


def test_the_curves_are_those_of_the_answers(both: Path, recording: Path) -> None:
    rows = [row for row in read(both / "cycles.csv") if row["run"] == "right, two_layer_viscoelastic"]
    assert numbers(rows, "gait_cycle_percent") == pytest.approx(PERCENT)
    assert {row["cycles"] for row in rows} == {"1"}
    strikes = [float(row["stamp_s"]) for row in read(both / "events.csv")
               if row["event"] == "heel strike" and row["run"] == "right, two_layer_viscoelastic"]  # fmt: skip
    answers = read_answers(recording)
    read_off = load_model("osteoarthritis").readouts(answers)
    time = answers["stamp"] / 1e9
    at = strikes[0] + (strikes[1] - strikes[0]) * PERCENT / 100.0
    units = {
        "deg": np.degrees(1.0),
        "mm": 1e3,
        "s": 1e3,
        "N": 1.0,
        "MPa": 1e-6,
        "percent": 100.0,
        "BW": 1.0 / BODY_WEIGHT,
    }
    for name, (field, _) in CURVE_COLUMNS.items():
        values = read_off[field] if field in SPREAD else answers.view(FLAT)[field]
        expected = np.interp(at, time, values) * units[name.rsplit("_", 1)[1]]
        # Nine digits in the file; stamps are rounded to 1 ns, of a course of at most 1 BW in 10 ms
        assert numbers(rows, f"{name}_mean") == pytest.approx(expected, rel=1e-6, abs=1e-6)
        assert {row[f"{name}_sd"] for row in rows} == {""}  # of a single cycle there is none
    assert list(rows[0]) == ["run", "gait_cycle_percent", "cycles",
                             *(f"{name}_{kind}" for name in CURVE_COLUMNS for kind in ("mean", "sd"))]  # fmt: skip


def test_the_peaks_are_those_of_the_demo(both: Path) -> None:
    rows = read(both / "peaks.csv")
    assert tuple(rows[0]) == PEAK_COLUMNS
    right = [row for row in rows if row["run"] == "right, kelvin_voigt"]
    assert [row["stamp_s"] for row in right] == ["0.785000000", "1.205000000", "2.015000000", "2.430000000"]
    assert [row["peak"] for row in right] == ["first", "second", "", ""]
    assert [row["cycle"] for row in right] == ["1", "1", "", ""]
    assert numbers(right, "time_s") == pytest.approx([0.255, 0.675, 1.485, 1.900], abs=1e-9)
    assert numbers(right, "load_N") == pytest.approx([1265.2, 1556.9, 1337.7, 1613.8], abs=0.05)  # the demo's digits
    assert numbers(right, "contact_force_N") == pytest.approx([1265.6, 1557.1, 1338.0, 1614.1], abs=0.05)
    assert numbers(right, "penetration_depth_mm") == pytest.approx([0.635, 0.729, 0.658, 0.747], abs=0.0005)
    for kind in ("load", "contact_force"):
        assert numbers(right, f"{kind}_BW") == pytest.approx(numbers(right, f"{kind}_N") / BODY_WEIGHT, rel=1e-8)
    percent = numbers(right[:2], "gait_cycle_percent")
    assert percent == pytest.approx([13.2, 47.3], abs=0.05)
    assert {row["run"] for row in rows} == RUNS


def test_the_strides_are_in_their_file(both: Path, recording: Path) -> None:
    rows = read(both / "strides.csv")
    assert tuple(rows[0]) == STRIDE_COLUMNS
    assert {row["run"] for row in rows} == RUNS
    (row,) = (row for row in rows if row["run"] == "right, two_layer_viscoelastic")
    answers = read_answers(recording)
    start, duration = float(row["heel_strike_s"]), float(row["duration_s"])
    inside = (answers["stamp"] >= start * 1e9) & (answers["stamp"] <= (start + duration) * 1e9)
    assert row["cycle"] == "1"
    speed = np.abs(answers["sliding_velocity"][inside])
    assert float(row["largest_sliding_velocity_mm_per_s"]) == pytest.approx(1e3 * speed.max(), rel=1e-8)
    # A sum of 5 ms each; the heel strikes lie between ticks
    assert float(row["sliding_distance_mm"]) == pytest.approx(1e3 * 0.005 * speed.sum(), rel=0.02)
    text = text_of(page_of(both))
    read_off = load_model("osteoarthritis").readouts(answers)
    columns = {"patch_half_width_mm": ("half_width", 1e3), "peak_pressure_MPa": ("peak_pressure", 1e-6)}
    columns["cartilage_strain_percent"] = ("strain", 100.0)
    for name, (field, factor) in columns.items():
        assert float(row[f"largest_{name}"]) == pytest.approx(factor * read_off[field][inside].max(), rel=1e-8)
    assert f"sliding distance [mm] {float(row['sliding_distance_mm']):.1f}" in text


def test_a_recording_from_before_sliding_and_force_error(old_recording: Path, tmp_path: Path) -> None:
    assert (
        main(["report", str(old_recording), "--compare", "osteoarthritis.yaml", "--output", str(tmp_path / "out")]) == 0
    )
    text = text_of(page_of(tmp_path / "out"))
    assert "error bound of the contact force not in this recording" in text
    assert "sliding distance [mm] –" in text
    old, compared = read(tmp_path / "out" / "strides.csv")
    assert old["sliding_distance_mm"] == old["largest_sliding_velocity_mm_per_s"] == ""
    assert float(compared["sliding_distance_mm"]) > 30.0  # computed now
    assert float(old["largest_penetration_depth_mm"]) == pytest.approx(0.729, abs=0.0005)
    for row in read(tmp_path / "out" / "peaks.csv")[:4]:
        assert row["contact_force_error_N"] == ""
        assert 0.0 < float(row["penetration_depth_error_mm"]) < 1e-3
    curves = read(tmp_path / "out" / "cycles.csv")[0]
    assert curves["sliding_velocity_mm_per_s_mean"] == ""
    assert curves["contact_force_N_mean"]


def test_the_events_are_in_their_file(both: Path) -> None:
    rows = read(both / "events.csv")
    assert tuple(rows[0]) == EVENT_COLUMNS
    left = [row for row in rows if row["run"] == "left, kelvin_voigt"]
    kinds = ["load peak", "toe-off", "heel strike", "load peak", "load peak", "toe-off", "heel strike"]
    assert [row["event"] for row in left] == kinds
    assert numbers(left, "stamp_s") == pytest.approx(numbers(left, "time_s") + 0.53, abs=1e-8)
    assert numbers(left, "load_BW") == pytest.approx(numbers(left, "load_N") / BODY_WEIGHT, rel=1e-8)
    assert numbers(left, "contact_force_BW") == pytest.approx(numbers(left, "contact_force_N") / BODY_WEIGHT, rel=1e-8)
    assert left[0]["text"] == "load peak 2.56 BW (1884.2 N)"
    assert float(left[0]["penetration_depth_mm"]) == pytest.approx(0.827, abs=0.0005)


def test_the_page_is_valid_and_needs_nothing_else(both: Path) -> None:
    page = page_of(both)
    check_html(page)
    references = re.findall(r"""(?:src|href|action|poster|data)\s*=\s*["']([^"']*)""", page)
    assert len(references) == 10  # nine pictures and an empty icon
    assert all(each.startswith("data:") for each in references)
    assert not re.search(r"https?://|@import|url\((?!data:)", page)
    pictures = re.findall(r'src="data:image/png;base64,([^"]+)"', page)
    assert [base64.b64decode(each) for each in pictures] == [
        (both / name).read_bytes()
        for name in (
            "knee_1.png",
            "knee_2.png",
            "contact_force.png",
            "depth.png",
            "flexion.png",
            "peak_pressure.png",
            "patch_half_width.png",
            "over_time_1.png",
            "over_time_2.png",
        )
    ]


def test_the_page_says_what_it_should(both: Path) -> None:
    text = text_of(page_of(both))
    for words in (
        "Knee contact: right, left", "not of a medical device", "medial compartment: 0.5 of the axial joint reaction",
        "doi:10.1186/ar4138", "387 in 1.93 s (200 Hz)", "0.747 mm", "0.538 mm", "0.915 s (47.4 %)",
        "the contact law has one layer", "ticks not converged", "impulse of stance [BW s]", "1.084", "1265.2", "47.3",
        "heel strike at 2° of flexion", "2 heel strikes, 1 toe-off, 4 load peaks.", "contact.layer_depth",
        "two_layer_viscoelastic", "but for the contact law of osteoarthritis.yaml", "The contact point does not move",
    ):  # fmt: skip
        assert words in text


def test_published_ranges_are_of_the_same_load(both: Path, moving: Path) -> None:
    assert "The load of these runs is the medial one." in text_of(page_of(both))
    text = text_of(page_of(moving))
    assert "The load of these runs is the total one." in text
    assert "total: the whole axial joint reaction" in text
    assert MEDIAL[0].text not in text
    assert TOTAL[0].text in text


def test_what_differs_is_below_every_figure(both: Path) -> None:
    page = page_of(both)
    captions = re.findall(r"<figcaption>(.*?)</figcaption>", page, flags=re.DOTALL)
    assert len(captions) == 9
    for caption in captions:
        assert "law: kelvin_voigt → two_layer_viscoelastic" in caption
        assert "layer_depth: – → 0.0005 m" in caption
    peaks, _, rest = page.partition("<figure>")
    assert "second peak: depth [mm]" in peaks  # on top
    assert "What these numbers are" in rest


def test_published_numbers_name_their_sources() -> None:
    for each in (*TOTAL, *MEDIAL, DEPTH):
        told = re.search(r"\[(.+)\]$", each.text)
        assert told
        assert [int(number) - 1 for number in told[1].split(", ")] == list(each.sources)
        assert all(SOURCES[number].text for number in each.sources)
        assert each.lowest <= each.highest


def test_a_recording_says_its_parameters_itself(recording: Path, tmp_path: Path) -> None:
    arguments = ["--compare", "healthy.yaml", "--output", str(tmp_path / "out")]
    assert main(["report", str(recording), *arguments]) == 0
    text = text_of(page_of(tmp_path / "out"))
    assert "Recorded with knee_contact_ros" in text
    assert "700 default 737.068" in text  # stored, and not that of healthy.yaml
    healthy, own = (
        [row for row in read(tmp_path / "out" / "peaks.csv") if row["run"] == f"knee, {law}"]
        for law in ("kelvin_voigt", "two_layer_viscoelastic")
    )
    assert float(healthy[1]["penetration_depth_mm"]) == pytest.approx(0.729, abs=0.0005)
    for rows in (healthy, own):  # healthy.yaml says 737.068 N, and a comparison is no other person
        assert float(rows[1]["load_BW"]) == pytest.approx(float(rows[1]["load_N"]) / 700.0, rel=1e-8)
    assert "body_weight 700 (not 737.068)" in text


def test_recordings_of_others_and_of_two_knees_in_one(recording: Path, tmp_path: Path) -> None:
    """Somebody else's recorder stores the messages, and no parameters."""
    path = tmp_path / "both.mcap"
    types = {f"/{topic}": MESSAGE_TYPES[topic] for topic in RECORDED if topic != KNEE_CONTACT_WRENCH}
    with BagWriter(path) as bag, BagReader(recording, types) as reader:
        for side in ("left", "right"):
            for topic, name in types.items():
                bag.add_topic(f"/{side}{topic}", name)
        for message in reader.raw_messages():
            for side in ("left", "right"):
                bag.write(f"/{side}{message.topic}", message.log_time, message.data)
    arguments = ["--compare", "healthy.yaml", "--output", str(tmp_path / "out")]
    assert main(["report", str(path), *arguments]) == 0
    rows = read(tmp_path / "out" / "peaks.csv")
    labels = list(dict.fromkeys(row["run"] for row in rows))
    assert labels == ["both left/knee_contact, not told", "both left/knee_contact, kelvin_voigt",
                      "both right/knee_contact, not told", "both right/knee_contact, kelvin_voigt"]  # fmt: skip
    depths = [max(float(row["penetration_depth_mm"]) for row in rows if row["run"] == label) for label in labels]
    assert depths == pytest.approx([0.538, 0.747] * 2, abs=0.0005)
    text = text_of(page_of(tmp_path / "out"))
    assert "contact.law: not told → kelvin_voigt" in text
    assert not list((tmp_path / "out").glob("knee_*.png"))  # of surfaces that nobody knows
    assert "Recorded without its parameters; healthy.yaml is taken for body weight and law." in text
    arguments = ["-p", "body_weight:=600.0", "--output", str(tmp_path / "again")]
    assert main(["report", str(path), *arguments]) == 0
    row = read(tmp_path / "again" / "peaks.csv")[0]
    assert float(row["load_BW"]) == pytest.approx(float(row["load_N"]) / 600.0, rel=1e-8)


def test_a_femur_from_mri_shows_the_way_of_the_contact_point(moving: Path) -> None:
    assert {path.name for path in moving.iterdir()} >= MOVING_FIGURES
    rows = read(moving / "cycles.csv")
    assert np.ptp(numbers(rows, "contact_point_x_mm_mean")) > 5.0


def test_without_gait_everything_is_over_time_and_an_earlier_report_gives_way(tmp_path: Path) -> None:
    bag = make_bag(tmp_path / "standing.mcap", [(i * 5_000_000, 0.1, 800.0) for i in range(400)])
    (tmp_path / "out").mkdir()
    earlier = {
        "report.html",
        "over_time_1.png",
        "over_time_7.png",
        "knee_2.png",
        "uncertainty.csv",
        "uncertainty_1.png",
    }
    for name in ("mine.txt", *earlier, *CYCLE_FIGURES, *MOVING_FIGURES, *TABLES):
        (tmp_path / "out" / name).write_text("earlier")
    assert main(["report", str(bag), "--output", str(tmp_path / "out")]) == 0
    ours = {"report.html", "knee_1.png", "over_time_1.png"} | TABLES
    assert {path.name for path in (tmp_path / "out").iterdir()} == ours | {"mine.txt"}
    assert (tmp_path / "out" / "mine.txt").read_text() == "earlier"
    assert page_of(tmp_path / "out").startswith("<!DOCTYPE html>")
    assert (tmp_path / "out" / "over_time_1.png").read_bytes().startswith(PNG)
    text = text_of(page_of(tmp_path / "out"))
    assert "No two heel strikes that follow each other" in text
    assert "0 heel strikes, 0 toe-offs, 0 load peaks." in text
    assert read(tmp_path / "out" / "cycles.csv") == read(tmp_path / "out" / "peaks.csv") == []


def test_the_page_escapes_what_it_is_given(moving: Path) -> None:
    page = page_of(moving)
    check_html(page)
    assert "<b onload" not in page
    assert "&lt;b onload=" in page


def test_what_makes_no_sense_stands_first(bags: tuple[Path, Path], both: Path, tmp_path: Path) -> None:
    """Solved for the report, and as a recording says it itself."""
    assert "What makes no sense" not in page_of(both)
    recording = tmp_path / "knee.mcap"
    solve(bags[0], load_parameters({"contact.stiffness": 2500.0}), recording, silent)
    pulled = make_bag(tmp_path / "pulled.mcap", [(i * 10_000_000, 0.1, -800.0) for i in range(121)])
    assert main(["report", str(recording), str(pulled), "--output", str(tmp_path / "out")]) == 0
    check_html(page_of(tmp_path / "out"))
    told = text_of(page_of(tmp_path / "out")).partition("What makes no sense.")[2].partition("Overview")[0]
    for words in (
        "knee: contact.stiffness 2500 N/m^1.5 gives 279 mm of depth under 368.5 N",
        "knee: 387 of 387 ticks are up to 359 mm deep, beyond 6.8 mm, a fifth of the femoral radius",
        "pulled: the load was negative throughout (-400 to -400 N)",
    ):
        assert told.count(words) == 1


@pytest.mark.parametrize("ticks", [1, 2, 3])
def test_a_few_ticks_are_a_report(tmp_path: Path, ticks: int) -> None:
    bag = make_bag(tmp_path / "few.mcap", [(i * 5_000_000, 0.1, 800.0) for i in range(ticks)])
    assert main(["report", str(bag), "--output", str(tmp_path / "out")]) == 0
    assert f"{ticks} in {0.005 * (ticks - 1):.2f} s" in text_of(page_of(tmp_path / "out"))


def test_where_the_height_drives_a_report_is_of_the_contact_force(tmp_path: Path) -> None:
    rows = [(i * 5_000_000, 0.1, 800.0) for i in range(100)]
    bag = make_bag(tmp_path / "pressed.mcap", rows, heights=0.0335 - 3e-4 * np.sin(0.05 * np.arange(100.0)) ** 2)
    parameters = load_parameters({"drive": "displacement"})
    solve(bag, parameters, tmp_path / "height.mcap", silent)
    assert main(["report", str(tmp_path / "height.mcap"), "--output", str(tmp_path / "out")]) == 0
    text = text_of(page_of(tmp_path / "out"))
    force = max(answer.contact_force for answer in read_answers(tmp_path / "height.mcap").view(np.recarray))
    assert "largest contact force: contact force [BW]" in text
    assert f"{force / BODY_WEIGHT:.2f}" in text.partition("Peaks")[2].partition("The knee at the peaks")[0]
    assert "The femoral height is prescribed (height)" in text
    assert "largest load:" not in text
    assert "contact force answers the load" not in text


def test_both_compartments_are_of_one_recording(bags: tuple[Path, Path], config: Path, tmp_path: Path) -> None:
    solve(bags[0], load_parameters([config / "both_compartments.yaml"]), tmp_path / "knee.mcap", silent)
    assert main(["report", str(tmp_path / "knee.mcap"), "--output", str(tmp_path / "out")]) == 0
    text = text_of(page_of(tmp_path / "out"))
    assert "in 1 recording: 387 ticks, 1 whole gait cycle." in text
    differs = text.partition("What differs")[2].partition("What these numbers are")[0]
    assert differs.split() == ["femur.profile:", "femur_medial.csv,", "femur_lateral.csv"]


def test_a_knee_that_lifts_off_is_told(tmp_path: Path) -> None:
    rows = [(i * 5_000_000, 0.1, -200.0 if 100 <= i < 120 else 800.0) for i in range(200)]
    bag = make_bag(tmp_path / "apart.mcap", rows)
    assert main(["report", str(bag), "-p", "femur.mass:=1.0", "--output", str(tmp_path / "out")]) == 0
    answers_apart = re.search(
        r"lifted off ([0-9.]+) s \([0-9.]+ %\), at most ([0-9.]+) s", text_of(page_of(tmp_path / "out"))
    )
    assert answers_apart is not None
    assert float(answers_apart[1]) == float(answers_apart[2]) > 0.09
