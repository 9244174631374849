"""The commands as a person runs them."""

import re
import signal
import subprocess
import sys
import time
from pathlib import Path

import psutil
import pytest

from knee_contact_ros.bags.answers import read_bag
from knee_contact_ros.commands.main import main
from knee_contact_ros.parameters.files import load_parameters
from knee_contact_ros.streams.topics import LOAD_ESTIMATE, MESSAGE_TYPES, RECORDED, types_of
from knee_contact_ros.view.output import DISPLAY_VARIABLES
from tests.helpers.needs import HAS_PICTURE, HAS_VIEWER, needs_viewer
from tests.helpers.offline import solve
from tests.helpers.processes import internet_sockets
from tests.helpers.terminals import Terminal
from tests.offline.test_solve import make_bag
from tests.ros.conftest import own_words

COMMAND = [sys.executable, "-m", "knee_contact_ros.commands.main"]
LOADS = Path("load_recording") / "load_recording_0.mcap"
TIMEOUT = 400  # two nodes on a new machine compile first


def run(*arguments):
    return subprocess.run(
        [*COMMAND, *map(str, arguments)],
        capture_output=True,
        text=True,
        timeout=TIMEOUT,
        check=False,
    )


def recorded(path, topics=RECORDED):
    types = types_of(topics)
    return [(m.topic, m.log_time, str(m.message)) for m in read_bag(path, types)]


def addresses(process):
    """Of its open sockets."""
    return {socket.laddr.ip for socket in internet_sockets(process)}


def test_two_demos_at_once_give_what_solve_gives(tmp_path, right_bag, config):
    """One beside a companion, which gives way and whose log is kept; the other one of a bag with bad samples."""
    rows = [(i * 5_000_000, 0.1, float("nan") if i in (3, 7) else 800.0) for i in range(40)]
    bag = make_bag(tmp_path / "in" / "bag.mcap", rows)
    knee = "healthy.yaml"
    options = {
        "companion": ["--companion"],
        "refused": ["--bag", bag, "--params", "osteoarthritis.yaml"],
    }
    demos = {
        name: subprocess.Popen(
            [*COMMAND, "demo", *more, "--output", tmp_path / name],
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        )
        for name, more in options.items()
    }
    said = {}
    for name, demo in demos.items():
        said[name], errors = demo.communicate(timeout=TIMEOUT)
        assert demo.returncode == 0, errors
        assert own_words(errors) == ""  # no progress bar in a pipe
        assert "Open the scene" not in said[name]  # nobody is asked in a pipe
        results = sorted(
            str(path.relative_to(tmp_path / name)) for path in (tmp_path / name).rglob("*")
        )
        expected = [
            "node.log",
            "recording",
            "recording/metadata.yaml",
            "recording/recording_0.mcap",
        ]
        optional = (
            ["companion.log"] * (name == "companion")
            + ["knee.png"] * HAS_PICTURE
            + ["knee_contact.rrd"] * HAS_VIEWER
        )
        assert results == [*optional, *expected]
    output, folder = said["companion"], tmp_path / "companion"
    assert "387 in 1.93 s" in output
    assert "dropped          0" in output
    assert "1613.8   2.19              1614.1   2.19        0.747" in output
    assert max(len(line.rstrip()) for line in output.split("\n\n")[0].splitlines()) <= 80
    if HAS_PICTURE:
        assert f"Knee at the peak: {folder / 'knee.png'}\n" in output
        assert (folder / "knee.png").read_bytes().startswith(b"\x89PNG")
    else:
        assert "No picture: matplotlib is not installed; " in output
    solve(right_bag, load_parameters(config / knee), tmp_path / "solved.mcap")
    assert recorded(tmp_path / "solved.mcap") == recorded(folder / "recording")
    torque = re.search(r"assist torque +([0-9.]+) N m, lowered to ([0-9.]+) N m", output)
    assert torque
    assert (
        10.0 >= float(torque[1]) > float(torque[2])
    )  # how far it falls depends on the machine's load
    log = (folder / "companion.log").read_text()
    times = log.count("giving way: the contact force is above 1400 N")
    pauses = log.count("no answer for 0.1 s") - 1  # the first one: before the first answer
    assert (
        2 <= times <= 2 + pauses
    )  # once a stance, and once more after a busy machine's pause amid it

    words = " ".join(said["refused"].split())
    assert "answers 38 in 0.20 s dropped 2" in words
    assert "samples refused 2 (2 x not_finite)" in words
    # Two ticks, or one, if both refusals come before the next answer: nothing orders the samples of two topics.
    assert re.search(r"answers flagged ([12]) \(\1 x INPUT_REJECTED\)", words)


@pytest.fixture(scope="module")
def estimated(sensors_bag, tmp_path_factory):
    """What `estimate-load` makes of the sensors' bag."""
    path = tmp_path_factory.mktemp("estimated") / "loads.mcap"
    assert (
        main(
            ["estimate-load", str(sensors_bag), "--params", "load/gait2354", "--output", str(path)]
        )
        == 0
    )
    return path


def test_from_sensors_the_companions_torque_assists_the_knee_that_it_listens_to(
    tmp_path, estimated
):
    """Its torque takes itself off the net moment; the load follows, down or up."""
    done = run("demo", "--from-sensors", "--companion", "--output", tmp_path)
    assert done.returncode == 0, done.stderr
    words = " ".join(done.stdout.split())
    assert "answers 387 in 1.93 s dropped 0 sensors to answer" in words
    assert (
        "load's level ground_force calibrated no: for looking, nothing may be limited or triggered by it"
        in words
    )
    told = re.search(r"largest contact ([0-9.]+) N without assistance, ([0-9.]+) N with it", words)
    assert told
    assert 700.0 < float(told[2]) < float(told[1]) < 850.0
    assert "warning people change how much they co-contract when" in words
    assert (
        "giving way: the contact force is above 700 N" in (tmp_path / "companion.log").read_text()
    )
    types = {f"/{LOAD_ESTIMATE}": MESSAGE_TYPES[LOAD_ESTIMATE]}
    live = [m.message for m in read_bag(tmp_path / LOADS, types)]
    torque = re.search(r"assist torque ([0-9.]+) N m", words)
    assert torque
    assert max(one.assistance for one in live) == pytest.approx(
        float(torque[1]), abs=0.3
    )  # 0.2 N m at 200 Hz
    alone = [m.message for m in read_bag(estimated, types)]
    pairs = [
        (one, other) for one, other in zip(alone, live, strict=True) if other.assistance > 0.0
    ]
    assert len(pairs) > 20
    less = [one.knee_moment - other.knee_moment - other.assistance for one, other in pairs]
    assert less == pytest.approx([0.0] * len(less), abs=1e-9)
    changes = [one.axial_force - other.axial_force for one, other in pairs]
    assert (  # noqa: PT018
        max(changes) > 10.0 and min(changes) < -10.0
    )  # where extensors are needed, and where they are not
    assert main(["solve", str(tmp_path / LOADS), "--output", str(tmp_path / "contact.mcap")]) == 0
    assert recorded(tmp_path / "recording") == recorded(tmp_path / "contact.mcap")


def test_an_interrupted_demo_opened_no_port_beyond_loopback_and_leaves_nothing(
    tmp_path,
):
    output, nodes = tmp_path / "out", 2
    command = [
        *COMMAND,
        "demo",
        "--from-sensors",
        "--companion",
        "--rate",
        "0.1",
        "--output",
        output,
    ]
    demo = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    deadline, processes = time.monotonic() + TIMEOUT, [psutil.Process(demo.pid)]
    all_of_them = (
        2 + 2 * nodes + HAS_VIEWER
    )  # with companion, nodes and their recorders, and viewer
    while (
        len(list(output.glob(".incomplete-*/*recording/*.partial"))) < nodes
        or len(processes) < all_of_them
    ):
        assert time.monotonic() < deadline
        time.sleep(0.1)
        processes[1:] = processes[0].children(recursive=True)
    assert len(processes) == all_of_them
    while sum(map(bool, map(addresses, processes))) < 2 + nodes:
        assert time.monotonic() < deadline
        time.sleep(0.1)
    time.sleep(1.0)
    assert sorted(map(sorted, map(addresses, processes))) == [
        *[[]] * (nodes + HAS_VIEWER),
        *[["127.0.0.1"]] * (2 + nodes),
    ]
    demo.send_signal(signal.SIGINT)
    printed, errors = demo.communicate(timeout=TIMEOUT)
    assert demo.returncode == 130
    assert own_words(errors).strip() == "knee-contact: interrupted"
    assert printed == ""
    assert not output.exists()
    assert not psutil.wait_procs(processes, timeout=TIMEOUT)[1]


def test_replay_says_when_nobody_listens(right_bag):
    done = run("replay", right_bag, "--rate", "20", "--wait", "0.1")
    assert done.returncode == 0
    assert "not every topic has a subscriber after 0.1 s" in done.stderr


@needs_viewer
def test_on_a_terminal_with_a_screen_it_offers_to_open_the_scene(tmp_path, monkeypatch):
    """Ctrl-D is a no; what is opened here is Rerun's viewer, which says that there is no such screen."""
    offers = f"offer(Path('{tmp_path}/a.rrd')); " * 3
    code = f"from pathlib import Path; from knee_contact_ros.commands.demo import offer; {offers}"
    for screen in DISPLAY_VARIABLES:
        monkeypatch.delenv(screen, raising=False)
    with Terminal(sys.executable, "-c", code) as terminal:
        assert "Open" not in terminal.wait_for(r"(?s)^(.*)\[ended with 0")[1]
    monkeypatch.setenv("DISPLAY", ":4711")
    asked = r"(?s)^(.*)Open the scene in the Rerun viewer\? \[Y/n\]"
    with Terminal(sys.executable, "-c", code) as terminal:
        for keys in (b"n\n", b"\x04", b"\n"):
            assert "viewer has ended" not in terminal.wait_for(asked)[1]
            terminal.press(keys)
        terminal.wait_for("viewer has ended")
        terminal.wait_for(r"\[ended with")
