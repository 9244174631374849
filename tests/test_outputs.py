"""Unfinished files: who writes them, and which were cut off."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from knee_contact_ros.errors import UsageError
from knee_contact_ros.outputs import claim, is_being_written, leftovers, open_claimed, refuse_existing

WRITER = """
import sys, time
from pathlib import Path
from knee_contact_ros.outputs import claim, open_claimed
file = open_claimed(claim(Path(sys.argv[1])))
print("open", flush=True)
time.sleep(60.0)
"""


def test_a_file_is_being_written_as_long_as_its_writer_lives(tmp_path: Path) -> None:
    path, partial = tmp_path / "out.mcap", tmp_path / "out.mcap.partial"
    with subprocess.Popen([sys.executable, "-c", WRITER, path], stdout=subprocess.PIPE, text=True) as writer:
        assert writer.stdout
        assert writer.stdout.readline() == "open\n"
        assert is_being_written(partial)
        assert leftovers(tmp_path) == []
        with pytest.raises(UsageError, match="is being written by another process"):
            refuse_existing(path)
        os.kill(writer.pid, signal.SIGKILL)
        writer.wait()
    assert not is_being_written(partial)
    assert leftovers(tmp_path) == [partial]
    with pytest.raises(UsageError, match="was cut off"):
        refuse_existing(path)


def test_leftovers_are_unfinished_recordings_only(tmp_path: Path) -> None:
    for name in ("b.mcap.partial", "a.mcap.partial", "whole.mcap", "view.rrd.partial", "metadata.yaml"):
        (tmp_path / name).touch()
    with open_claimed(claim(tmp_path / "live.mcap")):
        assert [path.name for path in leftovers(tmp_path)] == ["a.mcap.partial", "b.mcap.partial"]
    assert leftovers(tmp_path / "nowhere") == []


def test_a_claimed_file_is_emptied_by_its_writer_only(tmp_path: Path) -> None:
    partial = tmp_path / "out.mcap.partial"
    partial.write_text("earlier")
    with open_claimed(claim(tmp_path / "out.mcap", overwrite=True)) as file:
        assert partial.read_bytes() == b""
        file.write(b"new")
        file.flush()
        with pytest.raises(UsageError, match="is being written"):
            open_claimed(claim(tmp_path / "out.mcap", overwrite=True))
    assert partial.read_bytes() == b"new"
