"""Sinks in processes of their own, started and watched by tests."""

import struct
import time
from contextlib import suppress
from types import SimpleNamespace
from typing import NamedTuple

from mcap.exceptions import McapError
from mcap.reader import NonSeekingReader

from knee_contact_ros.bags import recorder
from knee_contact_ros.bags.answers import read_bag
from knee_contact_ros.bags.recorder import ABSOLUTE_NAMES, RecorderSettings
from knee_contact_ros.node.outputs import SinkProcess
from knee_contact_ros.parameters.files import load_parameters
from knee_contact_ros.streams.contact_pipeline import ContactPipeline
from knee_contact_ros.streams.messages import (
    JointState,
    WrenchStamped,
    encode_answer,
    encode_answer_wrench,
    encode_joint_state,
    encode_wrench_stamped,
)
from knee_contact_ros.streams.output import OPEN, Sink
from knee_contact_ros.streams.topics import (
    JOINT_REACTION_FORCE,
    JOINT_STATES,
    KNEE_CONTACT,
    KNEE_CONTACT_WRENCH,
    RECORDED,
    Ending,
    TickOutput,
    types_of,
)
from knee_contact_ros.view.anatomy import outlines_of
from knee_contact_ros.view.output import VIEWER_NICENESS, open_output
from tests.helpers.answers import contact
from tests.helpers.patience import patience, wait_until

TYPES = types_of(RECORDED)
MODEL = ContactPipeline(load_parameters({}), compiled=False).model
NOTHING_LEFT = Ending((), {})
SETTINGS = RecorderSettings(0.02)


class MayWait(NamedTuple):
    """What may wait: answers, and their memory [MB]."""

    queue: int = 20_000
    queue_size: float = 1000.0


QUEUE = MayWait()


def answer(number):
    """An answer that its number tells from others."""
    stamp, depth = 1_000_000 * number, 1e-6 * number
    row = contact(
        penetration_depth=depth, cartilage_depth=depth, stamp=stamp, contact_point=(0.0, 0.0, 0.0)
    ).tobytes()
    angle = encode_joint_state(JointState(stamp, "", ("knee",), (0.1,), (), ()))
    force = encode_wrench_stamped(WrenchStamped(stamp, "tibia", (0.0, -3.0, 0.0), (0.0, 0.0, 0.0)))
    records = [(JOINT_STATES, stamp, angle), (JOINT_REACTION_FORCE, stamp, force)]
    records += [(KNEE_CONTACT, stamp, encode_answer(stamp, "", row))]
    records += [(KNEE_CONTACT_WRENCH, stamp, encode_answer_wrench(stamp, "", row))]
    return TickOutput.of(row, tuple(records))


def put(sink, numbers):
    """Hand over some answers."""
    for number in numbers:
        sink.put_item(answer(number))


def close(sink, ending=NOTHING_LEFT, seconds=None):
    """Have an output completed, and wait for that; whether nothing is lost that must not be."""
    sink.request_end(ending)
    return sink.wait_until_complete(
        time.monotonic() + (patience() if seconds is None else seconds)
    )


def settled_backlog(sink):
    """Answers that wait once a socket takes no more."""
    looks = []
    while len(looks) < 10 or len(set(looks[-10:])) > 1:
        looks.append(sink.report_state()[0]["backlog"])
        time.sleep(0.05)
    return int(looks[-1])


def recorded_ticks(path):
    """The numbers of the answers in a recording."""
    return [
        message.log_time // 1_000_000
        for message in read_bag(path, {f"/{KNEE_CONTACT}": TYPES["/knee_contact"]})
    ]


def shown_ticks(path):
    """The numbers of the answers in a Rerun file."""
    from rerun.chunk import RrdReader

    stamps = []
    for chunk in RrdReader(path).stream():
        if chunk.entity_path == "/knee/curves/depth" and not chunk.is_static:
            stamps += chunk.to_record_batch().column("stamp").cast("int64").to_pylist()
    return sorted(stamp // 1_000_000 for stamp in stamps)


class Started:
    """Starts sinks and keeps what they tell."""

    def __init__(self):
        self.sinks = []
        self.told = []
        self.remarks = []
        self._log = SimpleNamespace(error=self.told.append, warning=self.remarks.append)

    def recorder(
        self,
        path,
        wait=True,
        settings=SETTINGS,
        queue=QUEUE,
    ):
        """A recorder."""
        return self.begun(recording(path, settings), wait, queue)

    def viewer(self, path, wait=True, queue=QUEUE):
        """A viewer."""
        arguments = path, [outlines_of(MODEL, "knee", 737.0)]
        sink = Sink(
            "viewer",
            "Rerun recording",
            str(path),
            open_output.__module__,
            arguments,
            "row",
            True,
            VIEWER_NICENESS,
        )
        return self.begun(sink, wait, queue, "rerun")

    def begun(self, sink, wait, queue=QUEUE, section="record"):
        """A sink; with `wait` an open one."""
        process = SinkProcess(sink._replace(section=section, limits=queue), self._log)
        self.sinks.append(process)
        if wait:
            process.wait_until_known()
            assert process.state == OPEN, process.failure
        return process


def recording(path, settings=SETTINGS):
    """A recorder, as it describes itself, but for the settings."""
    arguments = path, {}, ABSOLUTE_NAMES, settings
    return Sink(
        "recorder",
        "recording",
        str(path),
        recorder.__name__,
        arguments,
        "records",
        gaps_allowed=False,
    )


def pid(sink):
    """A sink's process."""
    wait_until(lambda: sink.process)
    return sink.process.pid


def readable(path, step=1_000_000):
    """The numbers of the answers, `step` [ns] apart, that can be read from a file that breaks off."""
    numbers = []
    with path.open("rb") as file, suppress(McapError, struct.error):
        for _, _, message in NonSeekingReader(file).iter_messages(
            f"/{KNEE_CONTACT}", log_time_order=False
        ):
            numbers.append(message.log_time // step)
    return numbers
