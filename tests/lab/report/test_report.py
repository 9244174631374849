"""`knee-contact report` as a person runs it: files, numbers and page; bad input, damaged bags and interruption."""

import base64
import io
import math
import re
from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest

import knee_contact_ros
from knee_contact_ros import load_model
from knee_contact_ros.bags.answers import read_answers
from knee_contact_ros.bags.provenance import (
    PARAMETERS_CHANGED,
    RESET,
    change_record,
    provenance_record,
)
from knee_contact_ros.bags.recorder import AnswerWriter, BagWriter
from knee_contact_ros.lab.report import figures
from knee_contact_ros.lab.report.figures import OF_MEDIAL, TOTAL
from knee_contact_ros.lab.report.gathered import (
    CYCLE_CURVES,
    CYCLE_PERCENT,
    EVENT_COLUMNS,
    PEAK_COLUMNS,
    STRIDE_COLUMNS,
)
from knee_contact_ros.model.readouts import READOUTS_OF_LAW
from knee_contact_ros.model.types import FLAT
from knee_contact_ros.parameters.files import load_parameters
from knee_contact_ros.streams.contact_pipeline import ContactPipeline
from knee_contact_ros.streams.topics import EACH_TICK, KNEE_CONTACT_WRENCH, types_of
from knee_contact_ros.view.picture import saved_figure
from tests.helpers.answers import answers_to
from tests.helpers.bags import raw_messages
from tests.helpers.offline import solve
from tests.lab.report.conftest import RUNS
from tests.lab.report.pages import check_html, numbers, page_of, rows_of, runs_of, text_of
from tests.offline.test_solve import make_bag
from tests.streams.test_gait_events import walking

pytest.importorskip(
    "matplotlib", minversion="3.7", reason="needs the extra report: matplotlib 3.7"
)

BODY_WEIGHT = 737.068
CYCLE_FIGURES = [
    f"{name}.png"
    for name in ("contact_force", "depth", "flexion", "peak_pressure", "patch_half_width")
]
FIGURES = ["knee_1.png", "knee_2.png", *CYCLE_FIGURES, "over_time_1.png", "over_time_2.png"]
"""Pictures of `both`, without that of the contact point, as a circle's stays"""
TABLES = {"cycles.csv", "events.csv", "peaks.csv", "strides.csv"}
LABEL = '_<b onload="x">&$\\no$'
PNG = b"\x89PNG\r\n\x1a\n"
UNITS = {
    "deg": np.degrees(1.0),
    "mm": 1e3,
    "s": 1e3,
    "N": 1.0,
    "MPa": 1e-6,
    "percent": 100.0,
    "BW": 1.0 / BODY_WEIGHT,
}
"""By the ends of the names of columns"""
in_group = pytest.mark.xdist_group("report")


@in_group
def test_all_files_are_there_and_nothing_is_cut_at_the_figures_edges(both):
    from PIL import Image

    files = {path.name for path in both.iterdir()}
    assert files == {"report.html", *FIGURES, *TABLES}
    for name in FIGURES:
        assert (both / name).read_bytes().startswith(PNG)
        with Image.open(both / name) as image:
            pixels = np.asarray(image.convert("L"))
        for edge in (pixels[0], pixels[-1], pixels[:, 0], pixels[:, -1]):
            assert edge.min() == 255, name
    page = page_of(both)
    check_html(page)
    references = re.findall(r"""(?:src|href|action|poster|data)\s*=\s*["']([^"']*)""", page)
    assert len(references) == len(FIGURES) + 1  # and an empty icon
    assert all(each.startswith("data:") for each in references)
    assert not re.search(r"https?://|@import|url\((?!data:)", page)
    pictures = re.findall(r'src="data:image/png;base64,([^"]+)"', page)
    assert {base64.b64decode(each) for each in pictures} == {
        (both / name).read_bytes() for name in FIGURES
    }


def test_letters_that_the_font_lacks_cause_no_warnings(recwarn):
    with saved_figure({"png": io.BytesIO()}, (1.0, 1.0), 50) as figure:
        figure.text(0.0, 0.0, "右\x1b")
    assert not recwarn.list


@in_group
def test_curves_are_those_of_the_answers_and_strides_are_written(both, recording):
    rows = runs_of(both / "cycles.csv")[RUNS[1]]
    assert numbers(rows, "gait_cycle_percent") == pytest.approx(CYCLE_PERCENT)
    assert {row["cycles"] for row in rows} == {"1"}
    events = runs_of(both / "events.csv")[RUNS[1]]
    strikes = [float(row["stamp_s"]) for row in events if row["event"] == "heel strike"]
    answers = read_answers(recording)
    read_off = load_model("osteoarthritis").readouts(answers)
    at = strikes[0] + (strikes[1] - strikes[0]) * CYCLE_PERCENT / 100.0
    for name, (field, *_) in CYCLE_CURVES.items():
        values = read_off[field] if field in READOUTS_OF_LAW else answers.view(FLAT)[field]
        expected = np.interp(at, answers["stamp"] / 1e9, values) * UNITS[name.rsplit("_", 1)[1]]
        # Nine digits in the file; stamps are rounded to 1 ns, of a course of at most 1 BW in 10 ms
        assert numbers(rows, f"{name}_mean") == pytest.approx(expected, rel=1e-6, abs=1e-6)
        assert {row[f"{name}_sd"] for row in rows} == {""}  # of a single cycle there is none
    own = [f"{name}_{kind}" for name in CYCLE_CURVES for kind in ("mean", "sd")]
    assert list(rows[0]) == ["run", "gait_cycle_percent", "cycles", *own]
    strides = runs_of(both / "strides.csv")
    assert list(strides) == RUNS
    (row,) = strides[RUNS[1]]
    assert tuple(row) == ("run", "cycle", *STRIDE_COLUMNS)
    assert f"sliding distance [mm] {float(row['sliding_distance_mm']):.1f}" in text_of(both)


PEAKS = {
    "stamp_s": ([0.785, 1.205, 2.015, 2.430], 1e-9),
    "time_s": ([0.255, 0.675, 1.485, 1.900], 1e-9),
    "load_N": ([1265.2, 1556.9, 1337.7, 1613.8], 0.05),
    "contact_force_N": ([1265.6, 1557.1, 1338.0, 1614.1], 0.05),
    "penetration_depth_mm": ([0.635, 0.729, 0.658, 0.747], 0.0005),
}
"""Peaks of the right knee, and tolerances: the demo's digits"""


@in_group
def test_peaks_and_events_are_those_of_the_demo(both):
    runs = runs_of(both / "peaks.csv")
    assert list(runs) == RUNS
    right = runs[RUNS[0]]
    assert tuple(right[0]) == ("run", *PEAK_COLUMNS)
    assert [row["peak"] for row in right] == ["first", "second", "", ""]
    assert [row["cycle"] for row in right] == ["1", "1", "", ""]
    for column, (expected, tolerance) in PEAKS.items():
        assert numbers(right, column) == pytest.approx(expected, abs=tolerance)
    assert numbers(right[:2], "gait_cycle_percent") == pytest.approx([13.2, 47.3], abs=0.05)
    left = runs_of(both / "events.csv")["left"]
    assert tuple(left[0]) == ("run", *EVENT_COLUMNS)
    kinds = "load peak, toe-off, heel strike, load peak, load peak, toe-off, heel strike"
    assert ", ".join(row["event"] for row in left) == kinds
    assert numbers(left, "stamp_s") == pytest.approx(numbers(left, "time_s") + 0.53, abs=1e-8)
    assert left[0]["text"] == "load peak 2.56 BW (1884.2 N)"
    assert float(left[0]["penetration_depth_mm"]) == pytest.approx(0.827, abs=0.0005)
    for rows in (right, left):
        for kind in ("load", "contact_force"):
            weights = numbers(rows, f"{kind}_N") / BODY_WEIGHT
            assert numbers(rows, f"{kind}_BW") == pytest.approx(weights, rel=1e-8)


def test_a_recording_from_before_sliding_and_force_error(old_recording, report):
    out = report(old_recording, "--compare=osteoarthritis.yaml")
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


ON_THE_PAGE = (
    "Knee contact: right, left",
    "not of a medical device",
    "contact force follows from the load, and differs from it by",
    "dotted vertical line: toe-off",
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
    "The largest load of right, 1.900 s after the first tick, is not within a whole gait cycle.",
    "stamps from … to [s] 0.530 … 2.460",
    "sliding distance [mm] 105.1 of a fixed hinge 105.1 of a fixed hinge 103.9 of a fixed hinge",
    "the total in vivo (knee implants: 2.5–2.8 BW) [1, 2]; computed, healthy people: 1.8–2, 2–2.3 BW [3]",
    "Where bone stops the femur, the contact force exceeds the load for some milliseconds",
    "Samples 5 ms apart miss part of this",
    "The contact laws differ, so these depths are not comparable.",
    "Not comparable between laws.",
    "body weight 737.1 N",
    "No measured range is drawn",
    "gait: right gait2354_right, left gait2354_left",
    "largest nominal strain [%] 16.6 of 4.4 mm 100.0 of 0.5 mm",
    "R 53.0 mm of contact.femoral_radius and contact.tibial_radius (34 and 95 mm), not of the surfaces",
)
ONCE = (
    "contact.law: kelvin_voigt → two_layer_viscoelastic",
    "contact.layer_depth: – → 0.0005 m",
)
PEAK_ROWS = (
    "largest contact force [BW] 2.19 2.19 3.03",
    "largest depth [mm] 0.747 0.538 0.929",
    "second peak: contact force [BW] 2.11 2.11 3.03",
)
"""As `solve` prints them for the right and the left leg, and with the other law; in whole cycles they are smaller"""


@in_group
def test_words_and_numbers_of_the_page(both):
    text = text_of(both)
    assert [words for words in ON_THE_PAGE if words not in text] == []
    assert [text.count(words) for words in ONCE] == [1, 1]
    assert "What makes no sense" not in text
    peaks = text.partition("Peaks")[2].partition("What differs")[0]
    assert [row for row in PEAK_ROWS if row not in peaks] == []
    assert sources_in(text) == {1, 2, 3}


def sources_in(text):
    """Numbers of the sources that figures cite: the same are listed."""
    captions, _, listed = text.partition("Over time")
    cited = re.findall(r"\[([\d, ]+)\]", captions.partition("Gait cycle")[2])
    numbers = {int(each) for several in cited for each in several.split(", ")}
    assert {int(each) for each in re.findall(r"\[(\d)\] \S", listed)} == numbers
    return numbers


def test_ringing_is_marked_where_it_is(bags, report):
    """The left knee as printed rings by 93 N, 0.13 body weights, but at its peaks by 0.01 and less."""
    text = text_of(report(bags[1], "--compare=osteoarthritis_as_printed"))
    assert "rings by up to 93.3 N" in text
    peaks = text.partition("Peaks")[2].partition("What differs")[0]
    assert re.findall(r"rings: ± ([\d.]+)", peaks) == ["0.01"]
    assert "first peak: contact force [BW] 1.59 1.59 (rings: ± 0.01)" in peaks
    cycles = text.partition("In each gait cycle")[2]
    largest = np.abs(solved_ringing(bags[1])).max() / BODY_WEIGHT
    assert f"(rings: ± {2.0 * largest / 0.02:.1f})" in cycles


def solved_ringing(bag):
    """Ringing [N] within the whole cycle."""
    with pytest.warns(UserWarning, match="rings"):
        gait = knee_contact_ros.solve(bag, "osteoarthritis_as_printed")
    (stride,) = gait.strides().itertuples()
    return [stride.ringing]


def test_comparisons_are_drawn_above_the_lines_of_recordings():
    runs = [SimpleNamespace(beside=beside) for beside in (None, 0, None, 2)]
    looks = [figures._look(runs, run) for run in runs]
    assert [look["linestyle"] for look in looks] == ["-", "--", "-", "--"]
    above = [look.get("zorder", 2.0) for look in looks]  # 2 is that of every line
    assert above[1] == above[3] > above[0] == above[2]


def test_another_load_and_femur(bags, report):
    """Other published ranges, a contact point that moves, and a label that is none of HTML."""
    files = ["--params=healthy.yaml", "--params=mri_femur.yaml"]
    files += ["-p", "translation.mechanism:=parallel_mechanism"]
    out = report(bags[0], *files, "-p", "load.compartment:=total", "--label", LABEL)
    check_html(page_of(out))
    text = text_of(out)
    assert "total: the whole axial joint reaction" in text
    assert TOTAL[0].text in text
    assert OF_MEDIAL[0].text not in text
    assert sources_in(text) == {1, 4, 5}
    assert "of a fixed hinge" not in text
    assert "<b onload" not in page_of(out)
    assert "&lt;b onload=" in page_of(out)
    assert (out / "contact_point.png").exists()
    assert np.ptp(numbers(rows_of(out / "cycles.csv"), "contact_point_x_mm_mean")) > 5.0
    assert "Grey: peak deformations [4], 0.31 to 1.01 mm." in text  # 7 to 23 % of 4.4 mm


def test_three_recordings_have_means_deviations_and_paired_differences(bags, recording, report):
    out = report(*bags, recording, "--compare=healthy.yaml", "-p", "contact.law:=hertz")
    text = text_of(out)
    assert "body_weight: gait2354_right 737.068, gait2354_left 737.068, knee 700 N" in text
    strides = pd.read_csv(out / "strides.csv").groupby("run")["loading_rate_N_per_s"].mean()
    compared = strides.index.str.contains("with")
    first, second = strides[~compared].to_numpy(), strides[compared].to_numpy()
    weights = np.array([BODY_WEIGHT, BODY_WEIGHT, 700.0])  # in the order of the labels
    first, second, apart = first / weights, second / weights, (second - first) / weights
    half = 4.302653 * apart.std(ddof=1) / math.sqrt(3.0)  # Student's, two degrees of freedom
    means = [f"{each.mean():.1f} ± {each.std(ddof=1):.1f}" for each in (first, second)]
    ends = [f"{apart.mean() + each:+.1f}" for each in (0.0, -half, half)]
    row = f"loading rate [BW/s] {' '.join(means)} {ends[0]} ({ends[1]} to {ends[2]})"
    assert row in text.partition("3 recordings with healthy.yaml difference")[2]


def test_means_over_recordings_leave_out_what_laws_do_not_share(
    right_bag, config, report, tmp_path
):
    files = [tmp_path / f"{name}.mcap" for name in ("healthy", "mri_femur", "osteoarthritis")]
    for file in files:
        solve(right_bag, config / f"{file.stem}.yaml", file)
    group = text_of(report(*files)).partition("All recordings")[2]
    _, left_out, more = group.partition("Left out: what is not comparable under different laws.")
    rows = more.partition("Over time")[0]
    assert left_out
    assert "loading rate" in rows
    assert not re.search("depth|patch|pressure|strain|bone", rows)


def test_a_recording_has_its_own_parameters(recording, report):
    out = report(recording, "--compare=healthy.yaml")
    text = text_of(out)
    assert "Recorded with knee_contact_ros" in text
    assert "body_weight: 700 instead of 737.068 N" in text  # stored, and not that of healthy.yaml
    runs = runs_of(out / "peaks.csv")
    depth = float(runs["knee, with healthy.yaml"][1]["penetration_depth_mm"])
    assert depth == pytest.approx(0.729, abs=0.0005)
    for rows in runs.values():  # healthy.yaml says 737.068 N, and a comparison is no other person
        assert numbers(rows, "load_BW") == pytest.approx(numbers(rows, "load_N") / 700.0, rel=1e-8)


def test_changes_of_a_run_are_named(bags, tmp_path, report):
    """A tare of the force sensor, for example."""
    parameters, path = load_parameters([]), tmp_path / "tared.mcap"
    pipeline = ContactPipeline(parameters, compiled=False)
    with BagWriter(path) as bag:
        writer = AnswerWriter(bag, provenance_record(parameters, {}))
        for answer in answers_to(pipeline, raw_messages(bags[0])):
            writer.write_answer(answer.records())
            if pipeline.ticks == 100:
                writer.write_note(PARAMETERS_CHANGED, change_record(100, {"load.offset": -40.0}))
            if pipeline.ticks in (200, 300):
                writer.write_note(RESET, {"tick": str(pipeline.ticks)})
        writer.write_ending(pipeline.ending())
    assert "Meanwhile: load.offset -40.0, a reset." in text_of(report(path))


def test_recordings_of_others_and_of_two_knees_in_one(recording, tmp_path, report):
    """Somebody else's recorder stores the messages, and no parameters."""
    path = tmp_path / "both.mcap"
    topics = (topic for topic in EACH_TICK if topic != KNEE_CONTACT_WRENCH)
    types = types_of(topics)
    with BagWriter(path) as bag:
        for side in ("left", "right"):
            for topic, name in types.items():
                bag.add_topic(f"/{side}{topic}", name)
        for message in raw_messages(recording, types):
            for side in ("left", "right"):
                bag.write_message(f"/{side}{message.topic}", message.log_time, message.data)
    out = report(path, "--compare=healthy.yaml")
    runs = runs_of(out / "peaks.csv")
    names = [f"both {side}/knee_contact" for side in ("left", "right")]
    assert list(runs) == [f"{name}{law}" for name in names for law in ("", ", with healthy.yaml")]
    depths = [numbers(rows, "penetration_depth_mm").max() for rows in runs.values()]
    assert depths == pytest.approx([0.538, 0.747] * 2, abs=0.0005)
    text = text_of(out)
    assert "contact.law: not known → kelvin_voigt" in text
    assert "without its parameters; healthy.yaml is taken for body weight and law." in text
    assert not list(out.glob("knee_*.png"))  # of surfaces that nobody knows
    out = report(path, "-p", "body_weight:=600.0")
    assert not (out / "peak_pressure.png").exists()  # of a law that nobody knows
    rows = rows_of(out / "peaks.csv")
    assert numbers(rows, "load_BW") == pytest.approx(numbers(rows, "load_N") / 600.0, rel=1e-8)


def test_without_gait_everything_is_over_time_and_an_earlier_report_gives_way(tmp_path, report):
    samples = [(i * 5_000_000, 0.1, 800.0) for i in range(400)]
    bag = make_bag(tmp_path / "standing.mcap", samples)
    out = tmp_path / "out"
    out.mkdir()
    earlier = ("over_time_7.png", "uncertainty.csv", "uncertainty_1.png", "contact_point.png")
    for name in ("mine.txt", "report.html", *earlier, *FIGURES, *TABLES):
        (out / name).write_text("earlier")
    for kind, begin in (("svg", b"<?xml"), ("pdf", b"%PDF"), ("png", PNG)):
        report(bag, "--figures", kind)
        files = {path.name for path in out.iterdir()}
        assert files == {
            "report.html",
            f"knee_1.{kind}",
            f"over_time_1.{kind}",
            "mine.txt",
            *TABLES,
        }
        assert (out / f"over_time_1.{kind}").read_bytes().startswith(begin)
    assert (out / "mine.txt").read_text() == "earlier"
    assert "No two successive heel strikes" in text_of(out)
    assert "Found: heel strikes 0, toe-offs 0, load peaks 0 (" in text_of(out)
    assert rows_of(out / "cycles.csv") == rows_of(out / "peaks.csv") == []
    stamps, angle, load = walking(200.0, 3.0)
    samples = list(
        zip(stamps.tolist(), angle.clip(0.7).tolist(), (2.0 * load).tolist(), strict=True)
    )
    report(make_bag(tmp_path / "bent.mcap", samples))
    assert "Found: heel strikes 1, toe-offs 2, load peaks 5 (" in text_of(out)


@pytest.mark.filterwarnings("error::UserWarning")
def test_doubts_come_first(bags, tmp_path, report):
    """Solved for the report, and as a recording says it itself."""
    recording = tmp_path / "knee.mcap"
    solve(bags[0], {"contact.stiffness": 2500.0}, recording)
    samples = [(i * 10_000_000, 0.1, -800.0) for i in range(121)]
    out = report(recording, make_bag(tmp_path / "pulled.mcap", samples))
    check_html(page_of(out))
    found = text_of(out).partition("What makes no sense.")[2].partition("Peaks")[0]
    for words in (
        "knee: contact.stiffness 2500 N/m^1.5 gives 279 mm of depth under 368.5 N",
        "knee: 387 of 387 ticks are up to 359 mm deep, beyond 6.8 mm, a fifth of the femoral radius",
        "pulled: the load was negative throughout (-400 to -400 N)",
    ):
        assert found.count(words) == 1


def test_where_the_height_drives_a_report_is_of_the_contact_force(tmp_path, report):
    samples = [(i * 5_000_000, 0.1, 800.0) for i in range(100)]
    heights = 0.0335 - 3e-4 * np.sin(0.05 * np.arange(100.0)) ** 2
    bag = make_bag(tmp_path / "pressed.mcap", samples, heights=heights)
    recording, deviations = tmp_path / "height.mcap", tmp_path / "sd.yaml"
    solve(bag, {"drive": "displacement"}, recording)
    deviations.write_text("contact.stiffness: 20 %\n")
    out = report(recording, "--uncertainty", deviations)
    text = text_of(out)
    force = read_answers(recording)["contact_force"].max()
    stiffer = float(rows_of(out / "uncertainty.csv")[0]["force_at_largest_load_N"])
    # all but what the dashpot bears
    assert stiffer == pytest.approx(math.sinh(0.2) * force, rel=0.05)
    assert "At the largest contact force, with sign" in text
    assert f"largest contact force [BW] {force / BODY_WEIGHT:.2f}" in text
    assert "The femoral height is prescribed (height)" in text
    assert "largest load [" not in text
    assert "contact force follows from the load" not in text


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["nowhere.mcap"], "no bag at nowhere.mcap"),
        (["{bag}", "--label=a", "--label=b"], "--label: 2 given for 1 FILEs"),
        (["{bag}", "--compare=mri_femur.yaml"], "mri_femur.yaml: sets no contact.* parameter"),
        (["{bag}", "--uncertainty={wrong}"], "uncertainty: contact.stifness is not allowed"),
        (["{recording}", "--params=healthy.yaml"], "--params is for bags"),
        (["{csv}"], "femur_medial.csv"),
    ],
)
def test_bad_input_is_refused_in_a_line(
    arguments,
    words,
    bags,
    recording,
    config,
    tmp_path,
    report,
    capsys,
):
    wrong = tmp_path / "wrong.yaml"
    wrong.write_text("contact.stifness: 20 %\n")
    names = {"bag": bags[0], "recording": recording, "wrong": wrong}
    names["csv"] = config / "femur_medial.csv"
    out = report(*(each.format(**names) for each in arguments), code=2)
    error = capsys.readouterr().err
    assert words in error
    assert error.count("\n") == 1
    assert not out.exists()


def test_a_damaged_bag_is_reported_as_far_as_it_goes(bags, tmp_path, report, capsys):
    content = next(bags[0].glob("*.mcap")).read_bytes()
    cut = tmp_path / "cut.mcap"
    cut.write_bytes(content[: len(content) * 2 // 3])
    out = report(cut, code=1)
    assert capsys.readouterr().err.count("\n") == 1
    assert "The file is damaged" in text_of(out)
