"""What parameters ask of the outputs, in SI units and bytes."""

import math
from types import SimpleNamespace

import pytest

from knee_contact_ros.bags.recorder import ABSOLUTE_NAMES, FileLimits, RecorderSettings
from knee_contact_ros.node.outputs import RUN_STATE_BYTES, Outputs, Ring, sink_of, size_of
from knee_contact_ros.parameters.files import load_parameters
from knee_contact_ros.streams.contact_pipeline import ContactPipeline
from knee_contact_ros.streams.output import OPEN, STARTING, RecordedKnee
from knee_contact_ros.streams.topics import KNEE_CONTACT
from knee_contact_ros.system.errors import UsageError
from tests.helpers.sinks import NOTHING_LEFT, MayWait, answer, close, recorded_ticks


def described(**parameters):
    """A knee that outputs are described from."""
    read = load_parameters({name.replace("__", "."): value for name, value in parameters.items()})
    return RecordedKnee(
        read,
        {KNEE_CONTACT: ContactPipeline(read, compiled=False).model},
        ABSOLUTE_NAMES,
        {"version": "1"},
    )


OFF = dict.fromkeys(("sync_period", "max_size", "max_duration", "min_free"), 0.0)


@pytest.mark.parametrize(
    ("asked", "expected"),
    [
        (
            {
                "flush_period": 0.5,
                "sync_period": 2.0,
                "max_size": 1.5,
                "max_duration": 3.0,
                "min_free": 7.0,
            },
            RecorderSettings(0.5, FileLimits(1_500_000, 3_000_000_000), 7_000_000, 2.0),
        ),
        (
            {"flush_period": 0.5} | OFF,
            RecorderSettings(0.5, FileLimits(math.inf, math.inf), 0.0, 0.0),
        ),
    ],
)
def test_megabytes_and_seconds_become_bytes_and_nanoseconds(tmp_path, asked, expected):
    """What is 0 is off: without a limit."""
    path = str(tmp_path / "out.mcap")
    sink = sink_of(
        "record",
        described(record__path=path, **{f"record__{key}": value for key, value in asked.items()}),
    )
    assert sink
    assert sink.name == path
    assert sink.arguments[1:4] == ({"version": "1"}, ABSOLUTE_NAMES, expected)


def test_a_snapshot_is_no_larger_than_the_queue(started, tmp_path):
    """It begins within 10 ms of where the queue would, and the state of the run is asked for no more often."""
    asked = []
    ring = Ring(1e3, 10**6, 1e6, lambda: asked.append(1))
    for number in range(3000):
        ring.put_item(answer(number))
    sink, (items, *_) = (
        started.recorder(tmp_path / "out.mcap", wait=False, queue=MayWait(10**6, 1.0)),
        ring.kept_items(),
    )
    for item in items:
        sink.put_item(item)
    assert close(sink)
    most = 10 * (1_000_000 // (10 * size_of(answer(0)) + RUN_STATE_BYTES))
    assert most - 10 <= len(items) <= most
    assert 300 <= len(asked) <= 302
    assert recorded_ticks(tmp_path / "out.mcap") == list(range(3000 - len(items), 3000))


def test_a_snapshot_is_bounded_where_stamps_hardly_advance():
    """A sensor whose clock stands still fills no memory, and leaves the snapshot its answers."""
    ring = Ring(1e3, 250, 1e9, lambda: None)
    for _ in range(5000):
        ring.put_item(answer(1))
    assert 150 <= len(ring.kept_items()[0]) <= 250


def test_a_recording_that_is_not_open_yet_is_named():
    outputs, states = Outputs(knee := described(), None, lambda: None), {"a": STARTING, "b": OPEN}
    outputs._ending = [
        SimpleNamespace(name=each, state=states[each], failure="") for each in states
    ]  # type: ignore[misc]
    with pytest.raises(UsageError, match=r"^a is not open yet; try again"):
        outputs.save_snapshot([], NOTHING_LEFT, knee)
