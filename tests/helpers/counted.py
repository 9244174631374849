"""Counts what work costs: `python -m tests.helpers.counted live|solve LIBRARY` prints calls, allocations and wake-ups.

The work is bracketed by two looks at a file that is not there, between which `strace` shows its system calls.
"""

import ctypes
import json
import os
import sys
import time
from pathlib import Path
from tempfile import TemporaryDirectory
from threading import Event

SAMPLES, WARM = 1000, 200
"""Live samples that are counted, a second's worth with all regular work, and those before"""
BEGIN, END = "/counting/begins", "/counting/ends"
MILLISECOND = 1_000_000


class Counts:
    """Counts calls of functions, Python's and C's, and wake-ups of other threads, in this thread."""

    def __init__(self, library):
        self.library = ctypes.PyDLL(library) if library else None
        self.calls = self.wake_ups = 0

    def __enter__(self):
        Path(BEGIN).exists()
        if self.library:
            self.library.count_allocations()
        else:
            sys.setprofile(self.on_event)

    def __exit__(self, *_):
        sys.setprofile(None)
        allocations = self.library and self.library.allocations()
        Path(END).exists()
        self.found = {"calls": self.calls, "wake_ups": self.wake_ups, "allocations": allocations}

    def on_event(self, frame, event, _argument):
        self.calls += event in ("call", "c_call")
        self.wake_ups += event == "call" and frame.f_code is Event.set.__code__


def live(counts):
    """A second of a node at 1 kHz that records, by a clock that moves with the samples."""
    now = [1000.0]
    time.perf_counter = lambda: now[0]
    import rclpy

    from knee_contact_ros.node.contact_node import CONTACT_NODE
    from knee_contact_ros.node.managed_node import ManagedNode, Stop
    from knee_contact_ros.streams.messages import (
        JointState,
        WrenchStamped,
        encode_joint_state,
        encode_wrench_stamped,
    )

    with TemporaryDirectory() as folder:
        path = f"record.path:={folder}/knee.mcap"
        rclpy.init(args=["counted", "--ros-args", "-p", path, "--log-level", "fatal"])
        node = ManagedNode(CONTACT_NODE, Stop())
        node.configure()
        node.trigger_configure()
        node.trigger_activate()
        angles, forces = node.session.inputs
        messages = []
        for number in range(WARM + SAMPLES):
            stamp = 10**12 + number * MILLISECOND
            angle = JointState(stamp, "", ("knee",), (0.3 + 1e-4 * number,), (), ())
            force = WrenchStamped(stamp, "tibia", (0.0, -900.0, 0.0), (0.0, 0.0, 0.0))
            messages.append((encode_joint_state(angle), encode_wrench_stamped(force)))

        def feed(some):
            for angle, force in some:
                now[0] += 1e-3
                angles._on_message(angle)
                forces._on_message(force)

        feed(messages[:WARM])
        with counts:
            feed(messages[WARM:])
        assert node.session.pipeline.ticks == WARM + SAMPLES
        node.finish_session()
        node.destroy_node()
        rclpy.shutdown()
    return SAMPLES


def solve(counts):
    """The shipped gait, with a recording."""
    from knee_contact_ros.bags.bag import Bag
    from knee_contact_ros.offline.solve import solve
    from knee_contact_ros.parameters.files import load_parameters
    from knee_contact_ros.system.files import share_folder

    def run(output):
        with Bag(share_folder() / "bags" / "gait2354_right") as bag:
            return solve(bag, load_parameters("healthy"), output)

    with TemporaryDirectory() as folder:
        run(Path(folder, "first.mcap"))
        with counts:
            done = run(Path(folder, "second.mcap"))
    return done.ticks


if __name__ == "__main__":
    counts = Counts(sys.argv[2])
    work = {"live": live, "solve": solve}[sys.argv[1]](counts)
    found = {name: (number or 0) / work for name, number in counts.found.items()}
    sys.stdout.write(json.dumps(found | {"work": work}))
    sys.stdout.flush()
    os._exit(0)
