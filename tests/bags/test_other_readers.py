"""Recordings, in one file and in several, as other people's tools see them."""

import subprocess
import sys
from pathlib import Path

import pytest
from rosbags.highlevel import AnyReader
from rosbags.rosbag2 import Reader

from knee_contact_ros.bags.recorder import FileLimits
from tests.bags.test_split import MS, TICK, record
from tests.helpers.needs import needs_viewer

NUMBER = 500
"""Answers"""


@pytest.fixture(scope="module", params=["one file", "several files"])
def recording(request, tmp_path_factory):
    """The folder of a recording."""
    folder = tmp_path_factory.mktemp("recording")
    record(
        folder / "knee_0.mcap",
        range(NUMBER),
        FileLimits(duration=200 * MS) if "several" in request.param else FileLimits(),
    )
    return folder


def files(recording):
    """Of a recording."""
    return sorted(recording.glob("*.mcap"))


def test_rosbags_reads_it_as_one_bag(recording):
    with AnyReader([recording]) as reader:
        stamps = [
            stamp // MS
            for connection, stamp, _ in reader.messages()
            if connection.topic == "/knee_contact"
        ]
        assert reader.message_count == NUMBER * TICK
    assert stamps == list(range(NUMBER))
    with Reader(recording) as reader:  # the strict one
        assert reader.message_count == NUMBER * TICK
        assert reader.duration == (NUMBER - 1) * MS + 1
        for connection in reader.connections:
            assert connection.digest.startswith("RIHS01_")
            assert connection.ext.offered_qos_profiles[0].reliability.name == "RELIABLE"


@needs_viewer
def test_rerun_takes_every_file(recording, tmp_path):
    rerun = Path(sys.executable).with_name("rerun")
    for path in files(recording):
        target = tmp_path / f"{path.name}.rrd"
        command = [rerun, "mcap", "convert", path, "--application-id", "knee", "-o", target]
        done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=120.0)
        assert done.returncode == 0, done.stderr
        assert "ERROR" not in done.stderr
        done = subprocess.run(
            [rerun, "rrd", "verify", target], capture_output=True, text=True, check=False
        )
        assert done.returncode == 0, done.stderr
