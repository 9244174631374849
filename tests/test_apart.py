"""Sinks in processes of their own: what was sent is kept, and nothing that happens to them is felt by the sender."""

from __future__ import annotations

import os
import signal
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import psutil
import pytest

from knee_contact_ros.answer import Answer
from knee_contact_ros.apart import Job, SinkProcess
from knee_contact_ros.errors import UsageError
from knee_contact_ros.record_answers import ABSOLUTE_NAMES
from knee_contact_ros.sinks import recorded_row
from tests.sinks import (
    NOTHING_LEFT,
    PATIENCE,
    SETTINGS,
    Started,
    answer,
    pid,
    put,
    recorded_ticks,
    settled_backlog,
    shown_ticks,
    wait_until,
)


def test_a_rerun_file_holds_every_answer(started: Started, tmp_path: Path) -> None:
    sink = started.viewer(tmp_path / "knee.rrd", wait=False)
    put(sink, range(250))
    sink.note("reset", {})
    put(sink, range(250, 387))
    sink.close(NOTHING_LEFT)
    assert (sink.failure, sink.dropped, started.told) == ("", 0, [])
    assert [path.name for path in tmp_path.iterdir()] == ["knee.rrd"]
    assert shown_ticks(tmp_path / "knee.rrd") == list(range(387))


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
