"""Drawn runs of a node's pipeline, recorded as the node records, and what `solve` of the recordings makes of them.

Clocks that differ or are set, samples that are lost, late, repeated or refused, changed parameters, resets, and other
publishers. `python -m studies.live streams` draws many; the tests draw some.
"""

from __future__ import annotations

import math
import random
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

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
from knee_contact_ros.model.types import FLAT, MESSAGE_FIELDS, Status
from knee_contact_ros.offline.solve import solve
from knee_contact_ros.parameters.files import all_values, load_parameters
from knee_contact_ros.streams.contact_pipeline import ContactAnswer, ContactPipeline
from knee_contact_ros.streams.messages import (
    JointState,
    WrenchStamped,
    encode_joint_state,
    encode_wrench_stamped,
)
from knee_contact_ros.streams.topics import recorded_topics

BEGIN = 10**12
"""First stamp [ns]"""
NOT_RECORDED = np.uint8(Status.INPUT_REJECTED)
"""Bits that `solve` of a recording does not repeat: no refused sample is in it"""
FLAGS = np.uint8(Status.STALE_INPUT | Status.TIME_RESET | Status.SEVERAL_PUBLISHERS)
"""Bits that come from stamps, clocks and publishers"""
LONGEST_RUN = 4.0
"""Duration [s] of a run"""


class DrawnRun:
    """Run that is recorded as a node records it."""

    def __init__(self, dice: random.Random, path: Path) -> None:
        """Draw a run, and record it."""
        self._dice = dice
        parameters = load_parameters({"pairing.max_gap": dice.choice((0.05, 0.1, 0.2))})
        self._pipeline = ContactPipeline(parameters, compiled=True)
        self._leg = DrawnLeg()
        self._jump = 0
        """Time [ns] by which clocks have jumped at resets"""
        self.held = 0
        """Number of the first answer with a held angle, or of all answers"""
        with BagWriter(path) as bag:
            topics = {topic: f"/{topic}" for topic in recorded_topics(False)}
            self._writer = AnswerWriter(bag, provenance_record(parameters, {}), topics)
            for act in self._acts():
                act()
            self._take(self._pipeline.finish_streams())
            self._writer.write_ending(self._pipeline.ending())

    def _acts(self) -> Iterator[Callable[[], None]]:
        """Yield what happens, in the order of arrival."""
        dice = self._dice
        rate = dice.choice((50, 100, 200))
        rare = [
            (dice.uniform(0.2, LONGEST_RUN), act)
            for act in dice.sample((self._reset, self._change, self._others, self._flush), 3)
            for _ in range(dice.randint(0, 2))
        ]
        shifts = [
            (dice.uniform(0.3, LONGEST_RUN), dice.randrange(2), dice.uniform(-0.7, 0.7) ** 3)
            for _ in range(dice.randint(0, 2))
        ]
        latencies = dice.choice((0.0, 0.003, 0.03)), dice.choice((0.0, 0.003, 0.03))
        faulty = dice.choice((0.0, 0.02))
        events: list[tuple[float, int, float, Any]] = [(time, 2, time, act) for time, act in rare]
        for i in range(int(LONGEST_RUN * rate)):
            time = i / rate
            for stream in (0, 1):
                if dice.random() >= faulty:
                    shift = sum(size for at, of, size in shifts if of == stream and time >= at)
                    stamp = BEGIN + round(1e9 * (time + shift))
                    stamp -= dice.choice((0, 10**7, 10**10)) if dice.random() < faulty else 0
                    events.append((time + latencies[stream], stream, time, stamp))
        for _, kind, time, what in sorted(events, key=lambda event: event[:3]):
            yield what if kind == 2 else partial(self._push, kind, time, what)

    def _push(self, stream: int, time: float, stamp: int) -> None:
        stamp += self._jump
        if stream == 0:
            angle = 0.5 + 0.4 * math.sin(5.0 * time)
            state = JointState(stamp, "", ("knee",), (angle,), (), ())
            self._take(self._pipeline.push_joint_state(encode_joint_state(state)))
        else:
            force = (0.0, -800.0 - 500.0 * math.sin(7.0 * time), 0.0)
            wrench = WrenchStamped(stamp, "tibia", force, (0.0, 0.0, 0.0))
            self._take(self._pipeline.push_force(encode_wrench_stamped(wrench)))

    def _take(self, answers: Iterator[ContactAnswer]) -> None:
        """Record the notes and answers, in the order of the node."""
        while self._pipeline.notes:
            self._writer.write_note(*self._pipeline.notes.pop(0))
        for answer in answers:
            is_held = answer.pair.status & Status.INPUT_HELD
            self._writer.write_answer(self._leg.records_with_leg(answer))
            if self.held == self._pipeline.ticks - 1 and not is_held:
                self.held += 1

    def _reset(self) -> None:
        self._jump += self._dice.choice((0, 0, -500_000_000, 10**10))
        self._take(self._pipeline.finish_streams())
        note = self._pipeline.reset()
        self._take(iter(()))
        self._writer.write_note(*note)

    def _change(self) -> None:
        changes = {"contact.damping": self._dice.uniform(1e3, 9e3)}
        changed = load_parameters(all_values(self._pipeline.parameters) | changes)
        self._pipeline.retune(changed)
        self._writer.write_note(PARAMETERS_CHANGED, change_record(self._pipeline.ticks, changes))

    def _others(self) -> None:
        flag = self._dice.choice((Status.SEVERAL_PUBLISHERS, Status.OK))
        self._pipeline.synchroniser.flag_from_now("several publishers", int(flag))

    def _flush(self) -> None:
        self._take(self._pipeline.flush_expired(math.inf))


def flags_differ(live: Any, again: Any) -> bool:
    """Whether flags of stamps, clocks and publishers differ, also after a held angle, or an answer is missing."""
    most = len(live) - 1
    is_held = live["status"][:most] & Status.INPUT_HELD != 0
    if not np.array_equal(live["stamp"][:most], again["stamp"][:most]):
        return True
    return bool(((live["status"][:most] ^ again["status"][:most])[~is_held] & FLAGS).any())


def differences(dice: random.Random, folder: Path) -> str:
    """Names of what `solve` of a drawn run's recording answers otherwise; after the first held angle, only flags."""
    run = DrawnRun(dice, folder / "r.mcap")
    with Bag(folder / "r.mcap") as bag:
        recording = read_provenance(bag)
        assert recording  # noqa: S101  (it was just written)
        solve(bag, recording, folder / "o.mcap", overwrite=True)
    live, again = (read_answers(folder / name).view(FLAT) for name in ("r.mcap", "o.mcap"))
    for rows in (live, again):
        rows["status"] &= ~NOT_RECORDED
    most = min(run.held, len(again), len(live) - 1)
    different = [
        name
        for name in MESSAGE_FIELDS
        if not np.array_equal(live[name][:most], again[name][:most])
    ]
    if not different and flags_differ(live, again):
        return "flags"
    return " ".join(different)
