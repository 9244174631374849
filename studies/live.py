"""What a live node must hold, by random runs: changes while samples wait, clocks that differ, parameters, paths.

python -m studies.live WHAT [--count N] [--seed S]     (`parameters` starts a node: set ROS_DOMAIN_ID)
"""

from __future__ import annotations

import math
import os
import random
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import click
import numpy as np
import rclpy
from rcl_interfaces.srv import GetParameters
from rclpy.parameter import parameter_value_to_python

from knee_contact_ros.bags.answers import read_answers
from knee_contact_ros.bags.bag import Bag
from knee_contact_ros.bags.leg import DrawnLeg
from knee_contact_ros.bags.provenance import (
    PARAMETERS_CHANGED,
    change_record,
    provenance_record,
    read_provenance,
)
from knee_contact_ros.bags.recorder import AnswerWriter, BagWriter
from knee_contact_ros.commands.main import GROUPS
from knee_contact_ros.commands.options import FILE
from knee_contact_ros.model.types import BYTE_OF, FLAT, MESSAGE_FIELDS, Status
from knee_contact_ros.offline.solve import solve
from knee_contact_ros.parameters.files import all_values, known_parameters, load_parameters
from knee_contact_ros.parameters.schema import has_two_compartments
from knee_contact_ros.streams.contact_pipeline import ContactPipeline
from knee_contact_ros.streams.messages import (
    JointState,
    WrenchStamped,
    encode_joint_state,
    encode_wrench_stamped,
)
from knee_contact_ros.streams.topics import recorded_topics
from studies.drawn_runs import differences
from tests.ros.conftest import NodeProcess, Peer, call, set_parameters

PATIENCE = 20.0
"""Time [s] after which a command that does not end is stopped"""
STATUS = BYTE_OF.status
"""Place of the status among the bytes of an answer"""
LEAST = 0.005
"""Time [s] by which a clock may be set unseen"""
LONGEST = 10.0
"""Longest time [s] of a refusal, Python's start and a busy machine included"""


CHANGES = {
    "knee.flexion_offset": (-0.2, 0.2),
    "load.share": (0.3, 0.8),
    "contact.stiffness": (6e7, 1e8),
    "contact.damping": (0.0, 9e3),
    "femur.mass": (5.0, 12.0),
    "load.compartment_spacing": (0.03, 0.06),
}
FIXED = {
    "knee.flexion_sign": (1.0, -1.0),
    "pairing.angle_delay": (0.0, 0.01),
    "load.compartment": ("fixed_share", "moment_balance", "both"),
}
MS = 1_000_000


def walk(dice: random.Random, path: Path, compiled: bool = False) -> None:
    """Record a run whose sensors have a latency, with changes and late samples."""
    parameters = load_parameters({name: dice.choice(values) for name, values in FIXED.items()})
    pipeline, latency = ContactPipeline(parameters, compiled=compiled), dice.choice([0, 3, 30, 55])
    events = [(5 * i + dice.choice([0, 0, 0, 7]), i, "angle") for i in range(80)]
    events += [(5 * i + latency, i, "force") for i in range(80)]
    events += [(dice.randint(0, 400), 0, "change") for _ in range(dice.randint(1, 6))]
    with BagWriter(path) as bag:
        topics = {
            topic: f"/{topic}" for topic in recorded_topics(has_two_compartments(parameters))
        }
        writer = AnswerWriter(bag, provenance_record(parameters, {}), topics)
        leg = DrawnLeg()
        for _, i, kind in sorted(events):
            if kind == "change":
                name = dice.choice(list(CHANGES))
                value = round(dice.uniform(*CHANGES[name]), 4)
                changed = load_parameters(all_values(pipeline.parameters) | {name: value})
                pipeline.check_retune(changed)
                pipeline.retune(changed)
                writer.write_note(PARAMETERS_CHANGED, change_record(pipeline.ticks, {name: value}))
                continue
            stamp, angle = 5 * i * MS, 0.5 + 0.3 * (i % 40) / 40.0
            if kind == "angle":
                answers = pipeline.push_joint_state(
                    encode_joint_state(JointState(stamp, "", ("knee",), (angle,), (), ()))
                )
            else:
                force, torque = (0.0, -900.0 - 10.0 * (i % 20), 0.0), (1.0 * (i % 7), 0.0, 0.0)
                answers = pipeline.push_force(
                    encode_wrench_stamped(WrenchStamped(stamp, "", force, torque))
                )
            for answer in answers:
                writer.write_answer(leg.records_with_leg(answer))
        for answer in pipeline.finish_streams():
            writer.write_answer(leg.records_with_leg(answer))
        writer.write_ending(pipeline.ending())


def different_fields(folder: Path) -> list[str]:
    """Names of what `solve` of the walk `r.mcap` in a folder answers otherwise; `length` where it is too short."""
    recording = read_provenance(folder / "r.mcap")
    assert recording  # noqa: S101  (by `walk`)
    with Bag(folder / "r.mcap") as bag:
        solve(bag, recording, folder / "o.mcap", compiled=False)
    live, again = (read_answers(folder / name) for name in ("r.mcap", "o.mcap"))
    for rows in (live, again):
        rows["status"] &= ~np.uint8(Status.INPUT_REJECTED)  # no refused sample is in a recording
    different = [
        name
        for name in MESSAGE_FIELDS
        if not np.array_equal(live.view(FLAT)[name], again.view(FLAT)[name])
    ]
    return different if len(live) > 40 else ["length"]


def replay(dice: random.Random) -> str:
    """Parameters that change while samples wait or come late: `solve` of the recording gives the same bits.

    So does a fresh run with the same changes, which is compiled, while the first one is not.
    """
    again = random.Random()  # noqa: S311
    again.setstate(dice.getstate())
    with tempfile.TemporaryDirectory() as folder:
        paths = [Path(folder) / name for name in ("r.mcap", "fresh.mcap")]
        walk(dice, paths[0])
        walk(again, paths[1], compiled=True)
        live, fresh = (read_answers(path).view(FLAT) for path in paths)
        told = [
            f"fresh {name}"
            for name in MESSAGE_FIELDS
            if not np.array_equal(live[name], fresh[name])
        ]
        return " ".join([*different_fields(Path(folder)), *told])


def streams(dice: random.Random) -> str:
    """Clocks, losses, resets, other publishers: `solve` of the recording gives the same bits, flags included."""
    with tempfile.TemporaryDirectory() as folder:
        return differences(dice, Path(folder))


def clock(dice: random.Random) -> str:
    """A clock that is set for good: flagged after a second, unless it is by less than four intervals or 5 ms.

    Which sample of an interval came first is no part of the streams, so they lie apart by up to an interval less.
    """
    gap, rate = dice.uniform(0.02, 0.5), dice.choice([50, 100, 200, 500])
    pipeline = ContactPipeline(load_parameters({"pairing.max_gap": gap}), compiled=False)
    away = (
        dice.choice([-1.0, 1.0])
        * gap
        * math.exp(dice.choice([-1.0, 1.0]) * dice.uniform(0.2, 2.0))
    )
    found = []
    for i in range(int((4.0 + 2.0 * abs(away)) * rate)):
        stamp = round(1e9 * (10.0 + i / rate))
        ahead = stamp + (round(1e9 * away) if i >= rate else 0)
        angle = encode_joint_state(
            JointState(ahead, "", ("knee",), (0.6 + 0.5 * math.sin(6.0 * i / rate),), (), ())
        )
        answers = [*pipeline.push_joint_state(angle)]
        answers += pipeline.push_force(
            encode_wrench_stamped(WrenchStamped(stamp, "", (0.0, -1e3, 0.0), (0.0, 0.0, 0.0)))
        )
        found += [answer.rows[0][STATUS] for answer in answers if i > (2.5 + abs(away)) * rate]
    flagged = sum(bool(status & Status.STALE_INPUT) for status in found)
    is_set = abs(away) > LEAST + 4.0 / rate and abs(abs(away) - gap) > 1.0 / rate
    wrong = flagged < len(found) if is_set else abs(away) < LEAST and flagged > 0
    told = f"{away:.3f} s apart, max_gap {gap:.3f} s, {rate} Hz: {flagged} of {len(found)} flagged"
    return told if wrong or not found else ""


class Live:
    """A real node, whose parameters are set to what it may have and to what it may not."""

    def __init__(self) -> None:
        rclpy.init()
        self.peer, self.node, self.stamp = Peer(), NodeProcess("-p", "autostart:=true"), 0
        self.peer.wait_for_node()
        self.known = {
            name: one for name, one in known_parameters().items() if isinstance(one.default, float)
        }

    def value(self, name: str) -> Any:
        """A parameter of the node."""
        request = GetParameters.Request(names=[name])
        return parameter_value_to_python(
            call(self.peer, GetParameters, "/knee_contact/get_parameters", request).values[0]
        )

    def __call__(self, dice: random.Random) -> str:
        """Set one: the node answers, says why if it refuses, has what it says, and goes on answering samples."""
        name = dice.choice(list(self.known))
        ends = [
            end
            for end in (self.known[name].least, self.known[name].most)
            if isinstance(end, float) and math.isfinite(end)
        ]
        value = dice.choice(
            [
                *ends,
                dice.choice([*ends, 1.0]) * 10.0 ** dice.uniform(-3.0, 3.0),
                -1.0,
                0.0,
                1e-250,
                1e300,
                math.nan,
                math.inf,
                *[self.known[name].default] * 2,
            ]
        )
        before = self.value(name)
        done, reason = set_parameters(self.peer, {name: value})
        after = self.value(name)
        if done == bool(reason) or after != (value if done else before):
            return f"{name} {value!r}: {done} {reason!r}, {before!r} became {after!r}"
        count, self.stamp = len(self.peer.contacts), self.stamp + 5_000_000
        self.peer.send(self.stamp, 0.3, 800.0)
        self.peer.wait_until(lambda: len(self.peer.contacts) > count)
        return ""


def paths(dice: random.Random) -> str:
    """A link to itself, a pipe, a socket or a device for an option that takes a file: one line, code 2."""
    options = [
        (one, option)
        for group in GROUPS.values()
        for one in group
        for option in one.params
        if isinstance(option.type, click.Path) or getattr(option.type, "func", None) is FILE
    ]
    chosen, option = dice.choice(options)
    with tempfile.TemporaryDirectory() as folder:
        loop, pipe, listening = (Path(folder) / name for name in ("loop", "pipe", "socket"))
        loop.symlink_to("loop")
        os.mkfifo(pipe)
        with socket.socket(socket.AF_UNIX) as opened:
            opened.bind(str(listening))
            path = str(dice.choice([loop, pipe, listening, Path("/dev/full")]))
            words = [path] if isinstance(option, click.Argument) else [option.opts[0], path]
            arguments = [
                sys.executable,
                "-m",
                "knee_contact_ros.commands.main",
                str(chosen.name),
                *words,
            ]
            begin = time.monotonic()
            try:
                done = subprocess.run(
                    arguments, capture_output=True, text=True, timeout=PATIENCE, check=False
                )
            except subprocess.TimeoutExpired:
                return f"{chosen.name} {words}: it does not end"
    told, took = done.stderr.strip().splitlines(), time.monotonic() - begin
    right = done.returncode == 2 and len(told) == 1 and took < LONGEST
    return (
        ""
        if right
        else f"{chosen.name} {words}: code {done.returncode} in {took:.1f} s, {told[-3:]}"
    )


WHAT: dict[str, Callable[[], Callable[[random.Random], str]]] = {
    "replay": lambda: replay,
    "streams": lambda: streams,
    "clock": lambda: clock,
    "parameters": Live,
    "paths": lambda: paths,
}
"""Makers of what runs once for a random number generator, and tells what is wrong"""


@click.command()
@click.argument("what", type=click.Choice(list(WHAT)))
@click.option("--count", default=1000, show_default=True)
@click.option("--seed", default=1, show_default=True)
def main(what: str, count: int, seed: int) -> None:
    """Run one of these; exit code 1 if anything is wrong."""
    run, wrong = WHAT[what](), 0
    for number in range(count):
        told = run(random.Random(f"{seed} {number}"))  # noqa: S311
        if told:
            wrong += 1
            click.echo(f"{number}: {told}")
    if isinstance(run, Live):
        run.node.stop()
    click.echo(f"{what}, seed {seed}: {wrong} of {count} wrong")
    raise SystemExit(wrong > 0)


if __name__ == "__main__":
    main()
