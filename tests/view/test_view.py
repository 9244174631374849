"""`knee-contact view`: recordings and bags to a scene, what a person sees of it, and what cannot be seen."""

import os
import resource
import signal
import socket
import subprocess
import sys
import urllib.request
from contextlib import contextmanager, suppress
from http.client import HTTPException
from importlib import invalidate_caches
from pathlib import Path

import numpy as np
import psutil
import pytest

pytest.importorskip("rerun", reason="needs the extra viewer")


from knee_contact_ros.bags.provenance import (
    PARAMETERS_CHANGED,
    RESET,
    change_record,
    provenance_record,
)
from knee_contact_ros.bags.recorder import AnswerWriter, BagWriter
from knee_contact_ros.parameters.curves import curve_texts
from knee_contact_ros.parameters.files import load_parameters
from knee_contact_ros.streams.contact_pipeline import ContactPipeline
from knee_contact_ros.streams.topics import MESSAGE_TYPES, Ending
from knee_contact_ros.system.processes import free_port
from knee_contact_ros.view.anatomy import outlines_of
from knee_contact_ros.view.colours import BONE, CARTILAGE, COVER, DEPTH, FEMUR, FORCE, TIBIA
from knee_contact_ros.view.output import (
    DISPLAY_VARIABLES,
    NOT_INSTALLED,
    open_output,
    require_viewer,
)
from knee_contact_ros.view.plots import CONTACT_POINT, DETAIL_PLOTS, KNEE_PLOTS, SOLVER_PLOTS
from tests.helpers.bags import raw_messages
from tests.helpers.commands import run
from tests.helpers.processes import NO_BYTECODE, has_ended
from tests.helpers.viewer import pixels_of, rendered, wait_for, window_of
from tests.view.scenes import answers_of, column, entities, lists, texts_of

pytestmark = pytest.mark.xdist_group("the scene")  # what is drawn once is read by several
RECORDED = [
    plot
    for plot in (*KNEE_PLOTS, *DETAIL_PLOTS, *SOLVER_PLOTS)
    if not (plot.live or plot.from_readouts)
]
ANSWERS = MESSAGE_TYPES["knee_contact"]


def test_a_recording_looks_as_it_did_live(osteoarthritic, right_bag, tmp_path):
    stream = ContactPipeline(
        load_parameters(["osteoarthritis", "mri_femur"]),
        compiled=False,
    )
    now, then = tmp_path / "live.rrd", tmp_path / "later.rrd"
    live = open_output(now, [outlines_of(stream.model, "knee", 737.068)])
    for answer in answers_of(stream, right_bag):
        live.write([*answer.rows])
    live.finish(Ending((), {}))
    assert run(f"view {osteoarthritic} --save {then}") == 0
    seen = entities(now)
    assert seen.pop("/knee/curves/latency")
    assert seen == entities(then)
    for entity, components in seen.items():
        for component in components:
            assert lists(now, entity, component) == lists(then, entity, component), (
                entity,
                component,
            )


def test_bags_are_computed_and_knees_stand_side_by_side(osteoarthritic, right_bag, tmp_path):
    path, bag = tmp_path / "out.rrd", right_bag.with_name("gait2354_left")
    assert run(f"view {bag} {osteoarthritic} -p femur.radius:=0.03 --save {path}") == 0
    for knee in ("gait2354_left", "osteoarthritic"):
        for plot in RECORDED:
            if plot.path != CONTACT_POINT or knee == "osteoarthritic":  # that of a circle is still
                assert column(path, f"/{knee}/curves/{plot.path}").shape == (387, len(plot.series))
    assert [file.name for file in tmp_path.iterdir()] == ["out.rrd"]


def test_doubts_about_a_bag_are_printed_and_damage_ends_with_1(right_bag, tmp_path, capsys):
    cut, path = tmp_path / "cut.mcap", tmp_path / "out.rrd"
    cut.write_bytes((right_bag / "gait2354_right_0.mcap").read_bytes()[:40_000])
    assert run(f"view {cut} -p contact.stiffness:=2500.0 --save {path}") == 1
    printed, reported = capsys.readouterr()
    assert printed == f"Rerun file   {path}\n"
    soft, implausible, damaged = reported.splitlines()
    assert "contact.stiffness" in soft
    assert " ticks " in implausible
    assert damaged.startswith(
        f"knee-contact: bag {cut} is damaged, and solved as far as it can be read: the end is "
    )
    assert 100 < len(column(path, "/knee/curves/flexion", "Scalars:scalars")) < 387


def test_a_recording_from_before_sliding_and_force_error(old_recording, tmp_path):
    path = tmp_path / "out.rrd"
    assert run(f"view {old_recording} --save {path}") == 0
    later = {"sliding_velocity": [0], "force": [0, 1], "error": [0]}
    for plot in RECORDED:
        if plot.path != CONTACT_POINT:
            values = column(path, f"/knee/curves/{plot.path}")
            assert len(values) == 387
            assert np.flatnonzero(np.isnan(values).all(axis=0)).tolist() == later.get(
                plot.path, []
            ), plot.path


@pytest.mark.parametrize(
    ("files", "topics", "roots"),
    [
        (["both"], ["/left/knee_contact", "/right/knee_contact"], {"left", "right"}),
        (["one", "two"], ["/left/knee_contact"], {"left_1", "left_2"}),  # each file has this one
    ],
)
def test_namespaces_are_knees(
    osteoarthritic,
    tmp_path,
    capsys,
    files,
    topics,
    roots,
):
    """In what another recorder has of our answers under some names."""
    paths = [tmp_path / f"{name}.mcap" for name in files]
    for path in paths:
        with BagWriter(path) as bag:
            for topic in topics:
                bag.add_topic(topic, ANSWERS)
            for message in raw_messages(osteoarthritic, {"/knee_contact": ANSWERS}):
                for topic in topics:
                    bag.write_message(topic, message.log_time, message.data)
    bags = " ".join(map(str, paths))
    assert run(f"view {bags} --params osteoarthritis.yaml --save {tmp_path}/out.rrd") == 0
    assert {entity.split("/")[1] for entity in entities(tmp_path / "out.rrd")} == roots
    assert (
        f"{files[0]}.mcap does not hold its parameters: drawn with those of --params"
        in capsys.readouterr().err
    )


def test_notes_of_the_node_stand_at_their_time(right_bag, tmp_path):
    """With the line where bone begins."""
    parameters = load_parameters(["osteoarthritis"])
    stream = ContactPipeline(parameters, compiled=False)
    with BagWriter(tmp_path / "out.mcap") as bag:
        writer = AnswerWriter(bag, provenance_record(parameters, curve_texts(parameters, {})))
        for answer in answers_of(stream, right_bag):
            writer.write_answer(answer.records())
            if stream.ticks == 100:
                writer.write_note(
                    PARAMETERS_CHANGED, change_record(100, {"contact.layer_depth": 0.6e-3})
                )
            if stream.ticks == 200:
                writer.write_note(RESET, {"tick": "200"})
        writer.write_ending(stream.ending())
    path = tmp_path / "out.rrd"
    assert run(f"view {tmp_path}/out.mcap --save {path}") == 0
    assert {"1.025 s  parameters changed: contact.layer_depth = 0.0006", "1.525 s  reset"} <= set(
        texts_of(path)
    )
    line = lists(path, "/knee/curves/layer", "Scalars:scalars")
    assert min(stamp for stamp, value in line if value[0] > 0.55) == 1_030_000_000
    assert len(column(path, "/knee/curves/pressure")) == 100  # nothing is known of another law
    assert len(column(path, "/knee/curves/loading_rate")) == 386


@pytest.mark.parametrize(
    ("words", "reason"),
    [
        ("nothing.mcap --save out.rrd", "no bag at nothing.mcap"),
        ("text.mcap --save out.rrd", "text.mcap"),
        ("{bag}", "no screen for a viewer (DISPLAY is not set); use --save OUT.rrd or --serve"),
        ("{bag} --save old.rrd", "old.rrd exists already"),
        ("{bag} --save text.mcap/out.rrd", "text.mcap/out.rrd"),
        ("{bag} --save out.rrd --serve", "--save and --serve cannot be given together"),
        ("{bag} --save out.rrd --params none.yaml", "none.yaml"),
        ("{bag} rerun+http://127.0.0.1:1/proxy", "can only be viewed"),
        ("{bag} --serve --port 80", "1024"),
        ("nothing.rrd --serve", "no Rerun file at nothing.rrd"),
        ("{bag} {bag} --save out.rrd", "is given twice"),
        ("old.rrd --save out.rrd", "old.rrd is a Rerun file"),
        ("", "FILE"),
    ],
)
def test_bad_input_is_refused_in_one_line(
    words,
    reason,
    osteoarthritic,
    tmp_path,
    monkeypatch,
    capsys,
):
    for name in DISPLAY_VARIABLES:
        monkeypatch.delenv(name, raising=False)
    monkeypatch.chdir(tmp_path)
    Path("text.mcap").write_text("hello")
    Path("old.rrd").touch()
    assert run(f"view {words.format(bag=osteoarthritic)}") == 2
    out, error = capsys.readouterr()
    assert out == ""
    assert len(error.splitlines()) == 1
    assert reason in error
    assert sorted(path.name for path in tmp_path.iterdir()) == ["old.rrd", "text.mcap"]


@contextmanager
def viewing(words):
    """The command in a process of its own, which is gone afterwards with all that it has started."""
    command = [sys.executable, "-m", "knee_contact_ros.commands.main", "view", *words.split()]
    process = subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, start_new_session=True
    )
    try:
        yield process
    finally:
        with suppress(ProcessLookupError):
            os.killpg(process.pid, signal.SIGKILL)
        process.communicate()


def test_browsers_are_served_until_ctrl_c(osteoarthritic, capsys):
    port = next(port for port in (free_port() for _ in range(100)) if port < 65_000)
    words = f"{osteoarthritic} --serve --port {port}"
    with viewing(words) as process:

        def page():
            # While nobody listens, a connection to a port for outgoing ones may be answered by itself.
            with (
                suppress(OSError, HTTPException),
                urllib.request.urlopen(f"http://127.0.0.1:{port + 1}/") as answer,
            ):
                return bytes(answer.read())
            return b""

        assert b"<html" in wait_for(page, "the page").lower()
        family = [
            psutil.Process(process.pid),
            *psutil.Process(process.pid).children(recursive=True),
        ]
        sockets = [one for member in family for one in member.net_connections("tcp")]
        assert {one.laddr for one in sockets if one.status == psutil.CONN_LISTEN} == {
            ("127.0.0.1", port),
            ("127.0.0.1", port + 1),
        }
        with rendered(f"rerun+http://127.0.0.1:{port}/proxy") as screen:
            assert "knee: events" in screen.views()
        assert run(f"view {words}") == 2
        assert f"--port: {port} on 127.0.0.1: Address already in use" in capsys.readouterr().err
        os.kill(process.pid, signal.SIGINT)
        printed, errors = process.communicate(timeout=30.0)
        assert (process.returncode, errors) == (0, "")
    assert (
        f"http://127.0.0.1:{port + 1}?url=rerun%2Bhttp%3A%2F%2F127.0.0.1%3A{port}%2Fproxy"
        in printed
    )
    with socket.socket() as probe:
        assert probe.connect_ex(("127.0.0.1", port + 1)) != 0


def test_a_window_opens_and_a_signal_closes_it(osteoarthritic, hidden_screen):
    with (
        viewing(str(osteoarthritic)) as process,
        window_of(psutil.Process(process.pid), 2_460_000_000) as viewer,
    ):
        listening = [
            one.laddr.ip
            for one in viewer.net_connections("tcp")
            if one.status == psutil.CONN_LISTEN
        ]
        assert {*listening} == {"127.0.0.1"}
        folder = Path(viewer.cmdline()[-1]).parent
        assert folder.is_dir()
        os.kill(process.pid, signal.SIGTERM)
        printed, errors = process.communicate(timeout=30.0)
        assert (process.returncode, printed, errors.strip()) == (
            130,
            "",
            "knee-contact: interrupted",
        )
        assert has_ended(viewer)
        assert not folder.exists()


def test_the_viewer_is_found_among_the_packages_of_a_user(tmp_path, monkeypatch):
    (tmp_path / "rerun_cli").mkdir()
    for name in ("__init__.py", "rerun"):
        (tmp_path / "rerun_cli" / name).touch()
    monkeypatch.delitem(sys.modules, "rerun_cli", raising=False)
    monkeypatch.syspath_prepend(tmp_path)
    invalidate_caches()
    assert require_viewer() == tmp_path / "rerun_cli" / "rerun"


@pytest.mark.parametrize(
    "words", ["nowhere.mcap", "{bag} --save out.rrd", "rerun+http://127.0.0.1/"]
)
def test_the_command_says_what_to_install(
    words,
    right_bag,
    tmp_path,
    monkeypatch,
    capsys,
):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setitem(sys.modules, "rerun_cli", None)
    assert run(f"view {words.format(bag=right_bag)}") == 2
    assert capsys.readouterr().err == f"knee-contact: {NOT_INSTALLED}\n"
    assert not list(tmp_path.iterdir())


def test_view_ends_with_one_line_when_the_disk_is_full(osteoarthritic, tmp_path):
    path = tmp_path / "pictures" / "knee.rrd"
    path.parent.mkdir()
    done = subprocess.run(
        [
            sys.executable,
            "-m",
            "knee_contact_ros.commands.main",
            "view",
            str(osteoarthritic),
            "--save",
            str(path),
        ],
        capture_output=True,
        text=True,
        timeout=180,
        check=False,
        env=os.environ | NO_BYTECODE,
        preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_FSIZE, (300_000, 300_000)),
    )
    assert done.stderr.splitlines()[-1] == f"knee-contact: {path}.partial: File too large"
    assert done.returncode == 1
    assert not list(path.parent.iterdir())


PEAK = 2_430_000_000


@pytest.fixture(scope="module")
def scene(osteoarthritic, tmp_path_factory):
    path = tmp_path_factory.mktemp("scene") / "knee.rrd"
    assert run(f"view {osteoarthritic} --save {path}") == 0
    return path


def test_the_first_tab_shows_the_knee_and_its_curves(scene):
    with rendered(scene) as screen:
        screen.set_time("stamp", PEAK)
        shown = set(screen.views())
        others = {
            plot.title.format(thickness="0.5")
            for plot in (*DETAIL_PLOTS, *SOLVER_PLOTS)
            if not plot.live
        }
        others |= {
            f"knee: {name}" for name in ("leg and contact force", "contact and level", "events")
        }
        others |= {"What you see", "Stance, shaded, and swing"}
        assert others < shown
        assert len(shown) == 1 + len(KNEE_PLOTS) + len(others)
        for plot in KNEE_PLOTS:
            (title,) = (name for name in shown if name.startswith(plot.title.split("{")[0]))
            picture = screen.picture(title)
            for series in plot.series:
                if series.name.startswith(("contact force", "depth [", "flexion", "anterior")):
                    assert pixels_of(picture, series.colour, within=40) > 200, (title, series.name)
        plane = screen.picture("knee: sagittal plane, cartilage 2 × 0.25 mm")
        height, width, _ = plane.shape
        assert width > 700  # half of the window
        bones = pixels_of(plane, FEMUR) + pixels_of(plane, TIBIA)
        assert 0.15 < bones / (height * width) < 0.6
        assert pixels_of(plane, FORCE, within=30) > 300
        assert pixels_of(plane, COVER, within=30) > 300
        assert pixels_of(plane, CARTILAGE) > 500  # the overlap, magnified
        assert pixels_of(plane, BONE, within=30) > 30  # 0.04 mm of it, and the contact point
        assert screen.complaints() == []
        whole = screen.picture()
    assert whole.shape == (900, 1600, 3)
    assert pixels_of(whole, DEPTH, within=20) > 300


def test_rerun_alone_draws_the_leg_of_a_recording(osteoarthritic):
    with rendered(osteoarthritic) as screen:
        wait_for(lambda: not screen.complaints(), "the frames to be connected")
        (space,) = (view for view in screen.state.views if view.view_class == "3D")
        shown = screen.picture(space.name)
    assert pixels_of(shown, (204, 199, 191), within=60) > 200
