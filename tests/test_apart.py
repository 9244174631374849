"""Sinks in processes of their own: what was sent is kept, and nothing that happens to them is felt by the sender."""

from __future__ import annotations

import os
import re
import resource
import signal
import struct
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import suppress
from pathlib import Path
from shutil import disk_usage, rmtree
from typing import Any

import psutil
import pytest
from mcap.exceptions import McapError
from mcap.reader import NonSeekingReader
from mcap.records import Message, Metadata
from mcap.stream_reader import StreamReader
from rerun.chunk import RrdReader

from knee_contact_ros.answer import Answer, Ending
from knee_contact_ros.apart import Handling, Job, SinkProcess, Tell
from knee_contact_ros.cdr_in import JointState, WrenchStamped
from knee_contact_ros.cdr_out import encode_contact, encode_contact_wrench
from knee_contact_ros.core.types import Contact, Point
from knee_contact_ros.drawing import Serving, drawing_of
from knee_contact_ros.errors import UsageError
from knee_contact_ros.parameters import load_parameters
from knee_contact_ros.pipeline import Pipeline
from knee_contact_ros.record import Limits, Settings
from knee_contact_ros.record_answers import ABSOLUTE_NAMES, INTERRUPTED, PROVENANCE
from knee_contact_ros.sinks import recorded_row, recorder, viewer
from knee_contact_ros.solve import solve
from knee_contact_ros.stream_in.bag import BagReader, read_bag
from knee_contact_ros.summary import read_refused
from knee_contact_ros.topics import JOINT_REACTION_FORCE, JOINT_STATES, KNEE_CONTACT, MESSAGE_TYPES

TYPES = {f"/{topic}": name for topic, name in MESSAGE_TYPES.items()}
MODEL = Pipeline(load_parameters({}), compiled=False).model
NOTHING_LEFT = Ending((), {})
SETTINGS = Settings(0.02)
SERVING = Serving(port=0, window=False)
PATIENCE = 30.0
"""How long [s] to wait for what must come"""


def answer(number: int) -> Answer:
    """An answer that its number tells from others."""
    stamp, depth = 1_000_000 * number, 1e-6 * number
    contact = Contact(0.1, 2.0, 3.0, depth, 0.0, 0.01, Point(0.0, 0.0, 0.0), 0.03, depth, 0.0, 1, 2, 0, 1e-9, 12)
    angle = JointState(stamp, "", ("knee",), (0.1,), (), ())
    force = WrenchStamped(stamp, "tibia", (0.0, -3.0, 0.0), (0.0, 0.0, 0.0))
    inputs = ((JOINT_STATES, stamp, angle), (JOINT_REACTION_FORCE, stamp, force))
    message, wrench = encode_contact(stamp, "", contact), encode_contact_wrench(stamp, "", contact, (0.0, 1.0))
    return Answer(stamp, "", contact, 0.0, (0.0, 1.0), inputs, message, wrench)


def put(sink: SinkProcess, numbers: range) -> None:
    """Hand over some answers."""
    for number in numbers:
        sink.put(answer(number))


def wait_until(done: Callable[[], Any]) -> None:
    """Wait until something has happened."""
    deadline = time.monotonic() + PATIENCE
    while not done():
        assert time.monotonic() < deadline, "it did not happen in time"
        time.sleep(0.01)


def settled_backlog(sink: SinkProcess) -> int:
    """Answers that wait once a socket takes no more."""
    looks: list[str] = []
    while len(looks) < 4 or len(set(looks[-4:])) > 1:
        looks.append(sink.diagnostics()["backlog"])
        time.sleep(0.05)
    return int(looks[-1])


def recorded_ticks(path: Path) -> list[int]:
    """The numbers of the answers in a recording."""
    return [message.log_time // 1_000_000 for message in read_bag(path, {f"/{KNEE_CONTACT}": TYPES["/knee_contact"]})]


def shown_ticks(path: Path) -> list[int]:
    """The numbers of the answers in a Rerun file."""
    stamps: list[Any] = []
    for chunk in RrdReader(path).stream():
        if chunk.entity_path == "/knee/curves/depth" and not chunk.is_static:
            stamps += chunk.to_record_batch().column("stamp").cast("int64").to_pylist()
    return sorted(stamp // 1_000_000 for stamp in stamps)


class Started:
    """Starts sinks and keeps what they tell."""

    def __init__(self) -> None:
        self.sinks: list[SinkProcess] = []
        self.told: list[str] = []
        self.remarks: list[str] = []
        self._tell = Tell(self.told.append, self.remarks.append)

    def recorder(self, path: Path, wait: bool = True, settings: Settings = SETTINGS) -> SinkProcess:
        """A recorder."""
        return self._keep(recorder(path, {}, ABSOLUTE_NAMES, settings, self._tell, awaited=True), wait)

    def viewer(self, path: Path, wait: bool = True) -> SinkProcess:
        """A viewer."""
        return self._keep(viewer(path, SERVING, drawing_of(MODEL, "knee", 737.0), self._tell, awaited=True), wait)

    def begun(self, job: Job, row: Callable[[Answer], tuple[Any, ...]]) -> SinkProcess:
        """A sink that nobody waits for."""
        handling = Handling(row, 1000, gaps_allowed=False, patience=PATIENCE)
        return self._keep(SinkProcess("output", job, handling, self._tell, awaited=False), False)

    def _keep(self, sink: SinkProcess, wait: bool) -> SinkProcess:
        self.sinks.append(sink)
        if wait:
            sink.wait_until_open()
        return sink


def pid(sink: SinkProcess) -> int:
    """A sink's process."""
    wait_until(lambda: sink.process)
    assert sink.process
    return sink.process.pid


@pytest.fixture
def started() -> Iterator[Started]:
    """No process may be left by a test that has closed its sinks."""
    started = Started()
    yield started
    left = [sink.process for sink in started.sinks if sink.process and sink.process.returncode is None]
    for process in left:
        process.kill()
    assert left == []


def test_a_recording_holds_what_solve_writes(started: Started, right_bag: Path, config: Path, tmp_path: Path) -> None:
    parameters = load_parameters(config / "healthy.yaml")
    pipeline = Pipeline(parameters, compiled=False)
    sink = started.recorder(tmp_path / "live.mcap", wait=False)  # it takes answers before it is open
    with BagReader(right_bag) as bag:
        for topic, _, data in bag.raw_messages():
            for each in (pipeline.joint_state if topic == "/joint_states" else pipeline.joint_reaction_force)(data):
                sink.put(each)
    for data in (b"", b""):
        list(pipeline.joint_state(data))  # refused
    sink.close(pipeline.ending())
    assert (sink.failure, sink.dropped, started.told) == ("", 0, [])
    assert sink.diagnostics() | {"process": ""} == {"backlog": "0", "dropped": "0", "written": "387", "process": ""}
    solve(right_bag, parameters, tmp_path / "offline.mcap", lambda done, total: None)
    live, offline = (
        [(m.topic, m.log_time, str(m.message)) for m in read_bag(tmp_path / name, TYPES)]
        for name in ("live.mcap", "offline.mcap")
    )
    assert live == offline
    assert read_refused(tmp_path / "live.mcap") == {"undecodable": 2}
    assert sorted(path.name for path in tmp_path.iterdir()) == ["live.mcap", "metadata.yaml", "offline.mcap"]


def test_a_rerun_file_holds_every_answer(started: Started, tmp_path: Path) -> None:
    sink = started.viewer(tmp_path / "knee.rrd", wait=False)
    put(sink, range(250))
    sink.note("reset", {})
    put(sink, range(250, 387))
    sink.close(NOTHING_LEFT)
    assert (sink.failure, sink.dropped, started.told) == ("", 0, [])
    assert [path.name for path in tmp_path.iterdir()] == ["knee.rrd"]
    assert shown_ticks(tmp_path / "knee.rrd") == list(range(387))


def test_notes_stand_between_the_answers(started: Started, tmp_path: Path) -> None:
    sink = started.recorder(tmp_path / "out.mcap")
    sink.note("first", {"damping": "5000"})
    put(sink, range(3))
    sink.note("second", {"damping": "0"})
    put(sink, range(3, 4))
    sink.close(NOTHING_LEFT)
    order: list[Any] = []
    notes = [("first", {"damping": "5000"}), ("second", {"damping": "0"})]
    with (tmp_path / "out.mcap").open("rb") as file:
        for record in StreamReader(file).records:
            if isinstance(record, Metadata) and record.name in dict(notes):
                order.append((record.name, record.metadata))
            elif isinstance(record, Message) and (not order or order[-1] != record.log_time // 1_000_000):
                order.append(record.log_time // 1_000_000)
    assert order == [notes[0], 0, 1, 2, notes[1], 3]


def test_outputs_that_cannot_be_opened_are_told(started: Started, tmp_path: Path) -> None:
    for name in ("old.mcap", "old.rrd", "file"):
        (tmp_path / name).touch()
    exists = "exists already, and recordings are not overwritten"
    bad = {
        f"{tmp_path / 'old.mcap'} {exists}": started.recorder(tmp_path / "old.mcap", wait=False),
        f"{tmp_path / 'old.rrd'} {exists}": started.viewer(tmp_path / "old.rrd", wait=False),
        f"cannot write {tmp_path / 'file' / 'out.mcap'}: File exists": started.recorder(
            tmp_path / "file" / "out.mcap", wait=False
        ),
    }
    good = started.recorder(tmp_path / "new" / "out.mcap", wait=False)
    for words, sink in bad.items():
        for ask in (sink.wait_until_open, sink.is_open):
            with pytest.raises(UsageError) as caught:
                ask()
            assert str(caught.value) == words
        put(sink, range(5))
        assert sink.dropped == 5
        sink.discard()
    assert started.told == []  # those who wait tell it
    good.discard()
    assert good.failure == ""
    assert sorted(path.name for path in tmp_path.rglob("*")) == ["file", "new", "old.mcap", "old.rrd"]


def test_an_output_that_nobody_waits_for_is_told_if_it_cannot_be_opened(started: Started, tmp_path: Path) -> None:
    (tmp_path / "old.mcap").touch()
    arguments = (tmp_path / "old.mcap", {}, ABSOLUTE_NAMES, SETTINGS)
    sink = started.begun(Job("knee_contact_ros.record_answers", arguments), recorded_row)
    wait_until(sink.is_over)
    assert started.told == [f"{tmp_path / 'old.mcap'} exists already, and recordings are not overwritten"]


def test_the_last_words_of_a_process_are_heard_though_nothing_can_be_sent_to_it(started: Started) -> None:
    def row(_answer: Answer) -> tuple[()]:
        assert sink.process
        sink.process.wait()  # it ends between two looks at what it says
        return ()

    sink = started.begun(Job("knee_contact_ros.nowhere", ()), row)
    sink.put(answer(0))
    wait_until(sink.is_over)
    words = "ModuleNotFoundError: No module named 'knee_contact_ros.nowhere'"
    assert started.told == [f"output cannot be opened: {words}"]


def test_a_sink_may_be_opened_while_answers_come(started: Started, tmp_path: Path) -> None:
    sink = started.recorder(tmp_path / "out.mcap", wait=False)
    os.kill(pid(sink), signal.SIGSTOP)
    put(sink, range(10))
    assert not sink.is_open()
    os.kill(pid(sink), signal.SIGCONT)
    put(sink, range(10, 20))
    wait_until(sink.is_open)
    put(sink, range(20, 30))
    sink.close(NOTHING_LEFT)
    sink.put(answer(30))
    assert recorded_ticks(tmp_path / "out.mcap") == list(range(30))
    assert sink.dropped == 0


def test_a_process_that_does_not_start_is_told(started: Started, tmp_path: Path, monkeypatch: Any) -> None:
    def words(happens: Callable[[SinkProcess], None] = lambda sink: None) -> str:
        sink = started.recorder(tmp_path / "out.mcap", wait=False)
        happens(sink)
        with pytest.raises(UsageError) as caught:
            sink.wait_until_open()
        sink.discard()
        return str(caught.value).removeprefix(f"recording {tmp_path / 'out.mcap'} cannot be opened: ")

    with monkeypatch.context() as patch:
        patch.setattr("sys.executable", "/no/where")
        assert words() == "no process can be started: No such file or directory"
    with monkeypatch.context() as patch:
        patch.setattr("knee_contact_ros.apart.CHILD", "only_here")  # found where this process looks for its modules
        patch.syspath_prepend(tmp_path)
        (tmp_path / "only_here.py").write_text("raise SystemExit(7)")
        assert words() == "its process ended with code 7"
    monkeypatch.setattr("knee_contact_ros.apart.START", 0.05)
    assert words(lambda sink: os.kill(pid(sink), signal.SIGSTOP)) == "its process did not start within 0.05 s"
    assert started.told == []


def test_a_full_disk_stops_the_recording_and_says_so_once(started: Started, tmp_path: Path) -> None:
    path = tmp_path / "out.mcap"
    recording, picture = started.recorder(path, wait=False), started.viewer(tmp_path / "knee.rrd", wait=False)
    for sink in (recording, picture):
        sink.wait_until_open()
        resource.prlimit(pid(sink), resource.RLIMIT_FSIZE, (64 * 1024, 64 * 1024))
        put(sink, range(4000))
    wait_until(lambda: recording.failure and picture.failure)
    for sink in (recording, picture):
        put(sink, range(4000, 4010))
        assert sink.diagnostics()["backlog"] == "0"
        assert int(sink.diagnostics()["dropped"]) >= 10
        sink.close(NOTHING_LEFT)
    assert sorted(started.told) == sorted([recording.failure, picture.failure])
    assert recording.failure == f"recording {path} stopped: File too large"
    assert picture.failure.startswith(f"Rerun recording {tmp_path / 'knee.rrd'} stopped: ")  # Rerun itself says why
    assert sorted(p.name for p in tmp_path.iterdir()) == ["knee.rrd.partial", "out.mcap.partial"]


def readable(path: Path, step: int = 1_000_000) -> list[int]:
    """The numbers of the answers, `step` [ns] apart, that can be read from a file that breaks off."""
    numbers: list[int] = []
    with path.open("rb") as file, suppress(McapError, struct.error):
        for _, _, message in NonSeekingReader(file).iter_messages(f"/{KNEE_CONTACT}", log_time_order=False):
            numbers.append(message.log_time // step)
    return numbers


def test_what_was_written_before_the_disk_was_full_can_be_read(started: Started, tmp_path: Path) -> None:
    path = tmp_path / "out.mcap"
    sink = started.recorder(path)
    put(sink, range(1000))
    partial = path.with_name("out.mcap.partial")
    wait_until(lambda: len(readable(partial)) == 1000)
    resource.prlimit(pid(sink), resource.RLIMIT_FSIZE, (partial.stat().st_size + 1000,) * 2)
    put(sink, range(1000, 5000))
    wait_until(lambda: sink.failure)
    sink.close(NOTHING_LEFT)
    numbers = readable(partial)
    assert len(numbers) >= 1000
    assert numbers == list(range(len(numbers)))


def test_a_recording_ends_whole_before_the_disk_is_full(started: Started, tmp_path: Path) -> None:
    free = disk_usage(tmp_path).free
    path = tmp_path / "out.mcap"
    sink = started.recorder(path, settings=SETTINGS._replace(min_free=free - 50_000_000))
    put(sink, range(100))
    with (tmp_path / "other").open("wb") as file:
        os.posix_fallocate(file.fileno(), 0, 200_000_000)
    wait_until(lambda: sink.failure)
    sink.close(NOTHING_LEFT)
    assert started.told == [sink.failure]
    assert re.fullmatch(
        rf"recording {path} has ended, complete up to here: [\d.]+ MB are free on its disk, "
        r"and parameter record\.min_free keeps [\d.e+]+ MB",
        sink.failure,
    )
    assert recorded_ticks(path) == list(range(100))
    assert sorted(path.name for path in tmp_path.iterdir()) == ["metadata.yaml", "other", "out.mcap"]
    with path.open("rb") as opened:
        names = [record.name for record in StreamReader(opened).records if isinstance(record, Metadata)]
    assert names == [PROVENANCE, INTERRUPTED, "rosbag2"]


def test_a_nearly_full_disk_is_refused(started: Started, tmp_path: Path) -> None:
    path = tmp_path / "new" / "out.mcap"
    sink = started.recorder(path, wait=False, settings=SETTINGS._replace(min_free=1e18))
    with pytest.raises(UsageError, match=rf"cannot write {path}: [\d.]+ MB are free .* keeps 1e\+12 MB"):
        sink.wait_until_open()
    sink.discard()
    assert list(tmp_path.iterdir()) == []


def test_a_removed_folder_is_noticed_while_it_is_written(started: Started, tmp_path: Path) -> None:
    folder = tmp_path / "bag"
    sink = started.recorder(folder / "out.mcap")
    put(sink, range(100))
    rmtree(folder)
    wait_until(lambda: sink.failure)
    sink.close(NOTHING_LEFT)
    reason = "its file or folder was removed while it was written"
    assert started.told == [f"recording {folder / 'out.mcap'} stopped: {reason}"]


def test_recordings_that_were_cut_off_are_named_and_those_that_are_written_are_not(
    started: Started, tmp_path: Path
) -> None:
    for name in ("a", "b"):
        (tmp_path / f"{name}.mcap.partial").touch()
    first = started.recorder(tmp_path / "first.mcap")
    second = started.recorder(tmp_path / "second.mcap")
    expected = [
        f"{partial} is a recording that was cut off: `knee-contact recover {partial} OUT.mcap` makes it whole"
        for partial in (tmp_path / "a.mcap.partial", tmp_path / "b.mcap.partial")
    ]
    assert started.remarks == expected * 2
    assert started.told == []
    first.close(NOTHING_LEFT)
    second.close(NOTHING_LEFT)


def test_a_recorder_splits_and_loses_nothing(started: Started, tmp_path: Path) -> None:
    limits = Limits(duration=100_000_000)
    sink = started.recorder(tmp_path / "out.mcap", settings=SETTINGS._replace(limits=limits))
    put(sink, range(450))
    sink.note("parameters_changed", {"contact.damping": "0"})
    put(sink, range(450, 1050))
    sink.close(NOTHING_LEFT)
    assert started.told == []
    assert len(list(tmp_path.glob("*.mcap"))) == 11
    assert recorded_ticks(tmp_path) == list(range(1050))


def test_a_killed_recorder_that_splits_leaves_whole_files_and_one_that_breaks_off(
    started: Started, tmp_path: Path
) -> None:
    limits = Limits(duration=100_000_000)
    sink = started.recorder(tmp_path / "out.mcap", settings=SETTINGS._replace(limits=limits))
    put(sink, range(450))
    partial = tmp_path / "out_4.mcap.partial"
    wait_until(lambda: partial.exists() and len(readable(partial)) == 50 and (tmp_path / "out_3.mcap").exists())
    wait_until(lambda: len(recorded_ticks(tmp_path)) == 400)
    os.kill(pid(sink), signal.SIGKILL)
    wait_until(lambda: sink.failure)
    sink.close(NOTHING_LEFT)
    assert recorded_ticks(tmp_path) == list(range(400))
    assert readable(partial) == list(range(400, 450))


def test_a_killed_process_is_noticed_and_told_once(started: Started, tmp_path: Path) -> None:
    path = tmp_path / "out.mcap"
    sink = started.recorder(path)
    put(sink, range(100))
    wait_until(lambda: path.with_name("out.mcap.partial").stat().st_size > 10_000)
    os.kill(pid(sink), signal.SIGKILL)
    wait_until(lambda: sink.failure)  # though nothing is put
    put(sink, range(100, 105))
    sink.close(NOTHING_LEFT)
    assert started.told == [f"recording {path} stopped: its process was ended by SIGKILL"]
    assert sink.dropped == 5
    assert [p.name for p in tmp_path.iterdir()] == ["out.mcap.partial"]


def test_nothing_is_lost_while_a_recorder_stands_still(started: Started, tmp_path: Path) -> None:
    sink = started.recorder(tmp_path / "out.mcap")
    os.kill(pid(sink), signal.SIGSTOP)
    put(sink, range(2000))
    backlog = settled_backlog(sink)
    assert 0 < backlog < 2000
    put(sink, range(2000, 12_000))
    assert int(sink.diagnostics()["backlog"]) == backlog + 10_000  # all that `put` does
    os.kill(pid(sink), signal.SIGCONT)
    sink.close(NOTHING_LEFT)
    assert (sink.failure, sink.dropped) == ("", 0)
    assert recorded_ticks(tmp_path / "out.mcap") == list(range(12_000))


def test_a_viewer_that_stands_still_gets_the_oldest_and_the_rest_is_dropped_and_counted(
    started: Started, tmp_path: Path, monkeypatch: Any
) -> None:
    monkeypatch.setattr("knee_contact_ros.sinks.MOST_UNSHOWN", 500)
    sink = started.viewer(tmp_path / "knee.rrd")
    os.kill(pid(sink), signal.SIGSTOP)
    put(sink, range(480))
    last = 480 + 500 - settled_backlog(sink)
    assert last > 500
    put(sink, range(480, last + 101))
    wait_until(lambda: started.told)
    assert sink.dropped == 101
    assert sink.diagnostics()["backlog"] == "500"
    os.kill(pid(sink), signal.SIGCONT)
    sink.close(NOTHING_LEFT)
    assert started.told == [sink.failure]
    assert "knee.rrd has gaps: more than 500 answers waited" in sink.failure
    assert shown_ticks(tmp_path / "knee.rrd") == list(range(last))


def test_a_recording_has_no_gaps(started: Started, tmp_path: Path, monkeypatch: Any) -> None:
    monkeypatch.setattr("knee_contact_ros.apart.LAST_WORDS", 0.2)
    monkeypatch.setattr("knee_contact_ros.sinks.MOST_UNRECORDED", 1000)
    sink = started.recorder(tmp_path / "out.mcap")
    os.kill(pid(sink), signal.SIGSTOP)
    put(sink, range(900))
    assert settled_backlog(sink) > 0
    put(sink, range(900, 2000))
    wait_until(lambda: started.told)  # while it stands still
    sink.close(NOTHING_LEFT)
    assert sink.failure.endswith("out.mcap stopped: OverflowError: more than 1000 answers waited")
    assert started.told == [sink.failure]


def test_a_process_that_stands_still_does_not_hold_up_the_end(
    started: Started, tmp_path: Path, monkeypatch: Any
) -> None:
    monkeypatch.setattr("knee_contact_ros.sinks.PATIENCE", 0.3)
    sink = started.recorder(tmp_path / "out.mcap")
    os.kill(pid(sink), signal.SIGSTOP)
    put(sink, range(5000))  # more than the socket takes
    sink.close(NOTHING_LEFT)
    words = f"recording {tmp_path / 'out.mcap'} stopped: nothing moved for 0.3 s when it was to be completed"
    assert started.told == [sink.failure] == [words]
    assert sink.process
    assert sink.process.returncode == -signal.SIGKILL
    assert sink.dropped > 1000


def test_a_process_that_is_slow_to_start_is_not_ended_before_it_is_open(
    started: Started, tmp_path: Path, monkeypatch: Any
) -> None:
    monkeypatch.setattr("knee_contact_ros.sinks.PATIENCE", 0.1)
    sink = started.recorder(tmp_path / "out.mcap", wait=False)
    os.kill(pid(sink), signal.SIGSTOP)
    put(sink, range(10))
    closing = threading.Thread(target=sink.close, args=(NOTHING_LEFT,))
    closing.start()
    time.sleep(0.5)
    sink._handling = sink._handling._replace(patience=PATIENCE)  # it may take its time from here on
    os.kill(pid(sink), signal.SIGCONT)
    closing.join(PATIENCE)
    assert sink.failure == ""
    assert recorded_ticks(tmp_path / "out.mcap") == list(range(10))


def parent(path: str, count: int) -> None:
    """What the next test runs and kills: all has left this process, and its child has not read it yet."""
    sink = recorder(Path(path), {}, ABSOLUTE_NAMES, Settings(60.0), Tell(print, print))
    sink.wait_until_open()
    os.kill(pid(sink), signal.SIGSTOP)
    put(sink, range(count))
    wait_until(lambda: sink.diagnostics()["backlog"] == "0")
    time.sleep(0.1)
    print(pid(sink), flush=True)  # noqa: T201
    time.sleep(PATIENCE)


def test_a_recording_is_completed_when_the_node_is_gone(tmp_path: Path) -> None:
    path = tmp_path / "out.mcap"
    code = f"from tests.test_apart import parent; parent({str(path)!r}, 100)"
    with subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout
        child = psutil.Process(int(process.stdout.readline()))
        process.kill()
        process.wait()
        os.kill(child.pid, signal.SIGCONT)
        wait_until(lambda: not child.is_running() or child.status() == psutil.STATUS_ZOMBIE)
    assert recorded_ticks(path) == list(range(100))
    assert sorted(p.name for p in tmp_path.iterdir()) == ["metadata.yaml", "out.mcap"]
    with path.open("rb") as file:
        names = [record.name for record in StreamReader(file).records if isinstance(record, Metadata)]
    assert names == [PROVENANCE, INTERRUPTED, "rosbag2"]


def test_signals_to_all_processes_do_not_end_a_sink(started: Started, tmp_path: Path) -> None:
    sink = started.recorder(tmp_path / "out.mcap")
    assert os.getsid(pid(sink)) == pid(sink)  # so that a terminal does not send it any
    for number in (signal.SIGINT, signal.SIGTERM):
        os.kill(pid(sink), number)
    put(sink, range(10))
    sink.close(NOTHING_LEFT)
    assert recorded_ticks(tmp_path / "out.mcap") == list(range(10))


def test_a_sinks_process_is_lean_and_steps_back(started: Started, tmp_path: Path) -> None:
    sink = started.recorder(tmp_path / "out.mcap")
    process = psutil.Process(pid(sink))
    loaded = [Path(library.path).name for library in process.memory_maps()]
    assert not [name for name in loaded if "rcl" in name or "numpy" in name or "scipy" in name]
    assert process.nice() > psutil.Process().nice()
    assert all(Path(file.path).name == "out.mcap.partial" for file in process.open_files())
    sink.close(NOTHING_LEFT)


def test_files_in_the_working_folder_do_not_stand_in_for_libraries(
    started: Started, tmp_path: Path, monkeypatch: Any
) -> None:
    monkeypatch.chdir(tmp_path)
    for name in ("mcap", "queue", "knee_contact_ros"):
        Path(f"{name}.py").write_text("raise RuntimeError")
    sink = started.recorder(Path("out.mcap"))
    put(sink, range(3))
    sink.close(NOTHING_LEFT)
    assert recorded_ticks(Path("out.mcap")) == [0, 1, 2]
