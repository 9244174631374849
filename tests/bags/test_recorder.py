"""The recorder as a sink: what it keeps, whatever happens to it, its disk and the node."""

import os
import re
import resource
import signal
from shutil import disk_usage

import pytest
from mcap.records import Metadata
from mcap.stream_reader import StreamReader

from knee_contact_ros.bags.answers import read_bag
from knee_contact_ros.bags.bag import Bag
from knee_contact_ros.bags.leg import DrawnLeg
from knee_contact_ros.bags.recorder import (
    INTERRUPTION,
    BagWriter,
    FileLimits,
    check_recordable,
)
from knee_contact_ros.node.outputs import size_of
from knee_contact_ros.offline.summary import refused_samples
from knee_contact_ros.parameters.files import load_parameters
from knee_contact_ros.streams.contact_pipeline import ContactPipeline
from knee_contact_ros.streams.output import PROVENANCE
from knee_contact_ros.streams.topics import TickOutput
from knee_contact_ros.system.errors import UsageError
from tests.helpers.answers import answers_to
from tests.helpers.bags import raw_messages
from tests.helpers.needs import needs_viewer
from tests.helpers.offline import solve
from tests.helpers.patience import wait_until
from tests.helpers.sinks import (
    SETTINGS,
    TYPES,
    MayWait,
    answer,
    close,
    pid,
    put,
    readable,
    recorded_ticks,
    settled_backlog,
)

QUEUES = [MayWait(1000), MayWait(10**6, 2.2)]


def test_a_recording_holds_what_solve_writes(started, right_bag, tmp_path):
    parameters = load_parameters("healthy")
    pipeline = ContactPipeline(parameters, compiled=False)
    sink = started.recorder(
        tmp_path / "live.mcap", wait=False
    )  # it takes answers before it is open
    leg = DrawnLeg()
    for each in answers_to(pipeline, raw_messages(right_bag)):
        sink.put_item(TickOutput.of(each.rows[0], leg.records_with_leg(each)))
    for data in (b"", b""):
        pipeline.push_joint_state(data)  # refused
    close(sink, pipeline.ending())
    assert (sink.failure, sink.dropped, started.told) == ("", 0, [])
    said = {"backlog": "0", "full [%]": "0", "dropped": "0", "written": "387", "process": ""}
    values, *wrong = sink.report_state()
    assert (values | {"process": ""}, wrong) == (said, ["", False])
    solve(right_bag, parameters, tmp_path / "offline.mcap")
    live, offline = (
        [(m.topic, m.log_time, str(m.message)) for m in read_bag(tmp_path / name, TYPES)]
        for name in ("live.mcap", "offline.mcap")
    )
    assert live == offline
    with Bag(tmp_path / "live.mcap") as bag:
        assert refused_samples(bag) == {"undecodable": 2}
    assert sorted(path.name for path in tmp_path.iterdir()) == [
        "live.mcap",
        "metadata.yaml",
        "offline.mcap",
    ]


@needs_viewer
@pytest.mark.parametrize("size", [1000, 100_000])
def test_a_file_whose_size_another_process_changes_gets_no_final_name(tmp_path, size):
    bag = BagWriter(tmp_path / "out.mcap")
    bag.add_topic("/joint_states", TYPES["/joint_states"])
    for written in (10**4, 1):
        bag.write_message("/joint_states", 1, os.urandom(written))
        bag.flush()
    os.truncate(tmp_path / "out.mcap.partial", size)
    bag.write_message("/joint_states", 1, b"more")
    with pytest.raises(OSError, match="another process"):
        bag.close()
    assert not (tmp_path / "out.mcap").exists()
    bag.discard()


@needs_viewer
def test_a_full_disk_stops_the_recording_with_one_message(started, tmp_path):
    path = tmp_path / "out.mcap"
    recording, picture = (
        started.recorder(path, wait=False),
        started.viewer(tmp_path / "knee.rrd", wait=False),
    )
    for sink in (recording, picture):
        sink.wait_until_known()
        resource.prlimit(pid(sink), resource.RLIMIT_FSIZE, (64 * 1024, 64 * 1024))
        put(sink, range(4000))
    wait_until(lambda: recording.failure and picture.failure)
    for sink in (recording, picture):
        put(sink, range(4000, 4010))
        wait_until(lambda sink=sink: sink.report_state()[0]["backlog"] == "0")
        assert int(sink.report_state()[0]["dropped"]) >= 10
        assert close(sink) == (sink is picture)  # which may have gaps
    assert sorted(started.told) == sorted([recording.failure, picture.failure])
    assert recording.failure.startswith(f"recording {path} stopped: File too large")
    assert picture.failure.startswith(
        f"Rerun recording {tmp_path / 'knee.rrd'} stopped: File too large"
    )
    assert sorted(p.name for p in tmp_path.iterdir()) == ["knee.rrd.partial", "out.mcap.partial"]


def test_a_recording_ends_whole_before_the_disk_is_full(started, tmp_path):
    free = disk_usage(tmp_path).free
    path = tmp_path / "out.mcap"
    sink = started.recorder(path, settings=SETTINGS._replace(min_free=free - 50_000_000))
    put(sink, range(100))
    with (tmp_path / "other").open("wb") as file:
        os.posix_fallocate(file.fileno(), 0, 200_000_000)
    wait_until(lambda: sink.failure)
    close(sink)
    assert started.told == [sink.failure]
    assert re.fullmatch(
        rf"recording {path} has ended, complete up to here: [\d.]+ MB are free on its disk, "
        r"and parameter record\.min_free keeps [\d.e+]+ MB",
        sink.failure,
    )
    assert recorded_ticks(path) == list(range(100))
    assert sorted(path.name for path in tmp_path.iterdir()) == [
        "metadata.yaml",
        "other",
        "out.mcap",
    ]
    with path.open("rb") as opened:
        names = [
            record.name for record in StreamReader(opened).records if isinstance(record, Metadata)
        ]
    assert names == [PROVENANCE, INTERRUPTION, "rosbag2"]


def test_a_nearly_full_disk_is_refused(started, tmp_path):
    path = tmp_path / "new" / "out.mcap"
    sink = started.recorder(path, wait=False, settings=SETTINGS._replace(min_free=1e18))
    sink.wait_until_known()
    assert re.match(rf"cannot write {path}: [\d.]+ MB are free .* keeps 1e\+12 MB", sink.failure)
    close(sink)
    with pytest.raises(
        UsageError, match=r"free on its disk, 1000000000000\.0 MB are needed, and .* keeps 1 MB"
    ):
        check_recordable(path, 1e6, 1e18)
    assert list(tmp_path.iterdir()) == []


def test_a_killed_recorder_leaves_readable_files(started, tmp_path):
    limits = FileLimits(duration=100_000_000)
    sink = started.recorder(tmp_path / "out.mcap", settings=SETTINGS._replace(limits=limits))
    put(sink, range(450))
    partial = tmp_path / "out_4.mcap.partial"
    wait_until(
        lambda: (
            partial.exists()
            and len(readable(partial)) == 50
            and (tmp_path / "out_3.mcap").exists()
        )
    )
    wait_until(lambda: len(recorded_ticks(tmp_path)) == 400)
    os.kill(pid(sink), signal.SIGKILL)
    wait_until(lambda: sink.failure)
    close(sink)
    assert recorded_ticks(tmp_path) == list(range(400))
    assert readable(partial) == list(range(400, 450))


@pytest.mark.parametrize(("queue", "fits"), list(zip(QUEUES, (1000, 1100), strict=True)))
def test_a_recording_has_no_gaps(started, tmp_path, monkeypatch, queue, fits):
    monkeypatch.setattr("knee_contact_ros.system.processes.EXIT_TIMEOUT", 0.2)
    sink = started.recorder(tmp_path / "out.mcap", queue=queue)
    os.kill(pid(sink), signal.SIGSTOP)
    put(sink, range(900))
    backlog = settled_backlog(sink)  # the others are in the socket
    full = 100.0 * max(
        backlog / queue.queue, backlog * size_of(answer(0)) / (1e6 * queue.queue_size)
    )
    assert full > 25.0
    assert (
        sink.report_state()[1]
        == f"recording {sink.name} is behind: {full:.0f} % of its queue is full"
    )
    put(sink, range(900, 900 + fits))
    wait_until(lambda: started.told)  # while it stands still
    said = sink.report_state()[1:]
    wait_until(sink.is_over)
    put(sink, range(900))
    assert not close(sink)
    assert sink.dropped >= 900
    assert started.remarks == [
        f"recording {sink.name}: {sink.dropped} answers in all were not handed to it"
    ]
    assert said == (sink.failure, True)
    waited = f"more waited than {queue.queue} answers (parameter record.queue) or {queue.queue_size:g} MB"
    assert f"out.mcap stopped: {waited} (record.queue_size)" in sink.failure
    assert started.told == [sink.failure]
