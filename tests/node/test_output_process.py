"""Sinks in processes of their own: what was sent is kept, and nothing that happens to them is felt by the sender."""

import os
import platform
import re
import signal
import time
import tracemalloc
from pathlib import Path

import psutil
import pytest

from knee_contact_ros.node.output_process import SLICE
from knee_contact_ros.node.outputs import BATCH, size_of
from knee_contact_ros.parameters.files import load_parameters
from knee_contact_ros.streams.contact_pipeline import ContactPipeline
from knee_contact_ros.streams.messages import (
    JointState,
    WrenchStamped,
    encode_joint_state,
    encode_wrench_stamped,
)
from knee_contact_ros.streams.topics import TickOutput
from knee_contact_ros.view.output import VIEWER_NICENESS
from tests.helpers.needs import needs_viewer
from tests.helpers.patience import wait_until
from tests.helpers.sinks import (
    NOTHING_LEFT,
    MayWait,
    close,
    pid,
    put,
    recorded_ticks,
    recording,
    settled_backlog,
    shown_ticks,
)


def test_a_batch_is_sent_however_long_answers_are_gathered(started, tmp_path):
    """A small queue would be full before; the first answers may be sent while the process begins."""
    sink = started.begun(
        recording(tmp_path / "knee.mcap")._replace(gather=1e4), True, MayWait(2 * BATCH, 1.0)
    )
    put(sink, range(2 * BATCH))
    wait_until(lambda: int(sink.report_state()[0]["backlog"]) < BATCH)
    close(sink)
    assert recorded_ticks(tmp_path / "knee.mcap") == list(range(2 * BATCH))


@needs_viewer
def test_an_output_that_exists_is_left_alone_and_names_go_on(started, tmp_path):
    for name in ("knee.mcap", "knee_1.mcap.partial", "knee.rrd", "other.rrd.partial"):
        (tmp_path / name).write_text("earlier")
    sink, picture = started.recorder(tmp_path / "knee.mcap"), started.viewer(tmp_path / "knee.rrd")
    put(sink, range(10))
    put(picture, range(10))
    assert (sink.name, picture.name) == (
        str(tmp_path / "knee_2.mcap"),
        str(tmp_path / "knee_1.rrd"),
    )
    (tmp_path / "knee_2.mcap").write_text("quicker")
    close(sink)
    close(picture)
    assert recorded_ticks(tmp_path / "knee_2_1.mcap") == list(range(10))
    assert shown_ticks(tmp_path / "knee_1.rrd") == list(range(10))
    assert (tmp_path / "knee.mcap").read_text() == (tmp_path / "knee.rrd").read_text() == "earlier"
    assert (tmp_path / "knee_2.mcap").read_text() == "quicker"
    partial, drawn = tmp_path / "knee_1.mcap.partial", tmp_path / "other.rrd.partial"
    assert sorted(started.remarks) == sorted(
        [  # of two processes
            f"{tmp_path / 'knee.mcap'} is there already: this recording is {tmp_path / 'knee_2.mcap'}",
            f"{partial} is a recording that was cut off: `knee-contact recover {partial} OUT.mcap` makes it whole",
            f"{tmp_path / 'knee.rrd'} is there already: this Rerun recording is {tmp_path / 'knee_1.rrd'}",
            f"{drawn} is a recording that was cut off: `rerun rrd merge {drawn} -o OUT.rrd` makes it whole",
            f"something took the name {tmp_path / 'knee_2.mcap'} meanwhile: "
            f"the recording is {tmp_path / 'knee_2_1.mcap'}",
        ]
    )


def test_a_process_that_does_not_start_is_told(started, tmp_path, monkeypatch):
    def words(happens=lambda sink: None):
        sink = started.recorder(tmp_path / "out.mcap", wait=False)
        happens(sink)
        sink.wait_until_known()
        if sink.process and not sink.is_over():
            sink.process.send_signal(signal.SIGCONT)
        close(sink)
        return sink.failure.removeprefix(f"recording {tmp_path / 'out.mcap'}").removeprefix(
            " cannot be opened: "
        )

    with monkeypatch.context() as patch:
        patch.setattr("sys.executable", "/no/where")
        assert words() == "FileNotFoundError: [Errno 2] No such file or directory: '/no/where'"
    with monkeypatch.context() as patch:
        patch.setattr(
            "knee_contact_ros.node.outputs.WORKER", "only_here"
        )  # found where we look for modules
        patch.syspath_prepend(tmp_path)
        (tmp_path / "only_here.py").write_text("raise SystemExit(7)")
        assert words() == "its process ended with code 7"
    monkeypatch.setattr("knee_contact_ros.node.outputs.START", 0.05)
    assert (
        words(lambda sink: os.kill(pid(sink), signal.SIGSTOP))
        == ": its process has not started within 0.05 s"
    )
    assert len(started.told) == 3


@needs_viewer
def test_a_stalled_viewer_drops_and_counts_new_answers(started, tmp_path):
    sink = started.viewer(tmp_path / "knee.rrd", queue=MayWait(500))
    os.kill(pid(sink), signal.SIGSTOP)
    number = backlog = 0
    while not backlog:  # until a socket takes no more
        put(sink, range(number, number + 480))
        number, backlog = number + 480, settled_backlog(sink)
    last = number + 500 - backlog
    put(sink, range(number, last + 101))
    wait_until(lambda: started.told)
    assert sink.dropped == 101
    assert sink.report_state()[0]["backlog"] == "500"
    os.kill(pid(sink), signal.SIGCONT)
    close(sink)
    assert started.told == [sink.failure]
    assert (
        "knee.rrd has gaps: more waited than 500 answers (parameter rerun.queue)" in sink.failure
    )
    assert sink.report_state()[1:] == (sink.failure, True)
    assert shown_ticks(tmp_path / "knee.rrd") == list(range(last))


@pytest.mark.parametrize("joints", [1, 100])
def test_queued_answers_take_the_memory_that_is_counted(joints):
    """As answers come from the pipeline, within a third; what is counted is what `record.queue_size` limits."""
    pipeline, names = (
        ContactPipeline(load_parameters({}), compiled=True),
        tuple(f"joint_{i}" for i in range(joints - 1)),
    )
    numbers = tuple(float(number) for number in range(joints))
    inputs = []
    for stamp in range(0, 2_000_000_000, 1_000_000):
        angle = JointState(stamp, "", ("knee", *names), numbers, numbers, numbers)
        force = WrenchStamped(stamp, "tibia", (0.0, -900.0, 0.0), (0.0, 0.0, 0.0))
        inputs.append((encode_joint_state(angle), encode_wrench_stamped(force)))
    waiting: list[TickOutput] = []

    def wait_for_answers(angle, force):
        answers = [*pipeline.push_joint_state(angle), *pipeline.push_force(force)]
        waiting.extend(
            [TickOutput.of(each.rows_with_latency(1e-4), each.records()) for each in answers]
        )

    for angle, force in inputs[:100]:  # what the first ones bring about stays
        wait_for_answers(angle, force)
    waiting.clear()
    tracemalloc.start()
    try:
        for angle, force in inputs[100:]:
            wait_for_answers(angle, force)
        taken, _ = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert len(waiting) == 1900
    assert 0.67 < taken / sum(map(size_of, waiting)) < 1.33


@pytest.mark.parametrize("number", [10, 5000])  # more than the socket takes
@pytest.mark.parametrize("is_open", [True, False])
def test_a_stalled_process_does_not_delay_the_end(started, tmp_path, is_open, number):
    sink = started.recorder(tmp_path / "out.mcap", wait=is_open)
    os.kill(pid(sink), signal.SIGSTOP)
    put(sink, range(number))
    if number == 10:
        wait_until(lambda: sink.report_state()[0]["backlog"] == "0")
    sink.request_end(NOTHING_LEFT)
    complete = sink.wait_until_complete(time.monotonic() + 0.1)
    (words,) = started.told
    label = f"recording {tmp_path / 'out.mcap'} is not complete yet, and is not waited for"
    told = re.fullmatch(
        rf"{label}: its process \({pid(sink)}\) goes on; (\d+) answers have not been handed to it",
        words,
    )
    assert told
    assert (complete, int(told[1]) > 0) == ((True, False) if number == 10 else (False, True))
    os.kill(pid(sink), signal.SIGCONT)
    wait_until(sink.is_over)
    assert recorded_ticks(tmp_path / "out.mcap") == list(range(number))
    assert len(started.told) == 1


@needs_viewer
def test_a_sink_process_is_lean_and_ends_on_request_only(started, tmp_path, monkeypatch):
    """Neither files in the working folder, which stand in for no libraries, nor signals to all processes end it."""
    monkeypatch.chdir(tmp_path)
    for name in ("mcap", "queue", "knee_contact_ros"):
        Path(f"{name}.py").write_text("raise RuntimeError")
    sink = started.recorder(tmp_path / "out.mcap")
    process = psutil.Process(pid(sink))
    assert os.getpgid(process.pid) == process.pid  # so that a terminal does not send it any signal
    assert os.getsid(process.pid) == os.getsid(
        0
    )  # so that it gets its share where sessions have shares
    loaded = [Path(library.path).name for library in process.memory_maps()]
    assert not [name for name in loaded if "rcl" in name or "numpy" in name or "scipy" in name]
    assert process.nice() == psutil.Process().nice()  # its share of a busy machine
    assert (
        os.sched_getscheduler(process.pid) == os.SCHED_BATCH
    )  # that it takes from nobody who runs
    state = Path(f"/proc/{process.pid}/sched")
    slices = re.findall(
        r"se\.slice +: +(\d+)", state.read_text(encoding="ascii") if state.exists() else ""
    )
    linux = [int(part) for part in platform.release().split(".")[:2]]
    assert linux < [6, 12] or slices in ([], [str(SLICE)])  # nor from anybody who wakes
    assert all(Path(file.path).name == "out.mcap.partial" for file in process.open_files())
    for number in (signal.SIGINT, signal.SIGTERM):
        process.send_signal(number)
    put(sink, range(10))
    close(sink)
    assert recorded_ticks(tmp_path / "out.mcap") == list(range(10))
    viewer = started.viewer(tmp_path / "knee.rrd")
    assert psutil.Process(pid(viewer)).nice() == min(
        psutil.Process().nice() + VIEWER_NICENESS, 19
    )  # 19 is the most
    close(viewer)


def test_answers_that_a_full_disk_keeps_out_of_the_file_are_counted(started, tmp_path):
    """They were handed to the process, which could not write them."""
    sink = started.begun(recording(tmp_path / "knee.mcap"), True)
    put(sink, range(BATCH))
    wait_until(lambda: sink.report_state()[0]["written"] == str(BATCH))
    kept = (tmp_path / "knee.mcap.partial").stat().st_size
    psutil.Process(pid(sink)).rlimit(psutil.RLIMIT_FSIZE, (kept, kept))
    put(sink, range(BATCH, 3 * BATCH))
    wait_until(sink.is_over)
    assert sink.dropped == 2 * BATCH
    assert "128 answers are not in it" in sink.failure
    assert recorded_ticks(tmp_path / "knee.mcap.partial") == list(range(BATCH))
