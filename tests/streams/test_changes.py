"""Parameters that change while samples wait: a recording holds them so that `solve` gives the same bits."""

from __future__ import annotations

import random
from pathlib import Path

import numpy as np
import pytest

from knee_contact_ros.bags.provenance import PARAMETERS_CHANGED, change_record, provenance_record, read_provenance
from knee_contact_ros.bags.reader import read_answers
from knee_contact_ros.bags.recorder import AnswerWriter, BagWriter
from knee_contact_ros.model.types import FLAT, TOLD, Status
from knee_contact_ros.offline.solve import solve
from knee_contact_ros.parameters.files import all_values, load_parameters
from knee_contact_ros.parameters.schema import has_both
from knee_contact_ros.streams.contact_stream import ContactStream
from knee_contact_ros.streams.messages import JointState, WrenchStamped, encode_joint_state, encode_wrench_stamped
from knee_contact_ros.streams.topics import recorded_topics

CHANGES = {
    "knee.flexion_offset": (-0.2, 0.2), "load.share": (0.3, 0.8), "contact.stiffness": (6e7, 1e8),
    "contact.damping": (0.0, 9e3), "femur.mass": (5.0, 12.0), "load.compartment_spacing": (0.03, 0.06),
}  # fmt: skip
FIXED = {
    "knee.flexion_sign": (1.0, -1.0), "pairing.angle_delay": (0.0, 0.01),
    "load.compartment": ("fixed_share", "moment_balance", "both"),
}  # fmt: skip
MS = 1_000_000


def walk(dice: random.Random, path: Path, compiled: bool = False) -> None:
    """Record a run whose sensors have a latency, with changes and late samples."""
    parameters = load_parameters({name: dice.choice(values) for name, values in FIXED.items()})
    pipeline, latency = ContactStream(parameters, compiled=compiled), dice.choice([0, 3, 30, 55])
    events = [(5 * i + dice.choice([0, 0, 0, 7]), i, "angle") for i in range(80)]
    events += [(5 * i + latency, i, "force") for i in range(80)]
    events += [(dice.randint(0, 400), 0, "change") for _ in range(dice.randint(1, 6))]
    with BagWriter(path) as bag:
        topics = {topic: f"/{topic}" for topic in recorded_topics(has_both(parameters))}
        writer = AnswerWriter(bag, provenance_record(parameters, {}), topics)
        for _, i, kind in sorted(events):
            if kind == "change":
                name = dice.choice(list(CHANGES))
                value = round(dice.uniform(*CHANGES[name]), 4)
                changed = load_parameters(all_values(pipeline.parameters) | {name: value})
                pipeline.check(changed)
                pipeline.retune(changed)
                writer.note(PARAMETERS_CHANGED, change_record(pipeline.ticks, {name: value}))
                continue
            stamp, angle = 5 * i * MS, 0.5 + 0.3 * (i % 40) / 40.0
            if kind == "angle":
                answers = pipeline.joint_state(encode_joint_state(JointState(stamp, "", ("knee",), (angle,), (), ())))
            else:
                force, torque = (0.0, -900.0 - 10.0 * (i % 20), 0.0), (1.0 * (i % 7), 0.0, 0.0)
                answers = pipeline.force(encode_wrench_stamped(WrenchStamped(stamp, "", force, torque)))
            for answer in answers:
                writer.write(answer.records)
        for answer in pipeline.finish():
            writer.write(answer.records)
        writer.finish(pipeline.ending())


def different_fields(folder: Path) -> list[str]:
    """Names of what `solve` of the walk `r.mcap` in a folder answers otherwise; `length` where it is too short."""
    recording = read_provenance(folder / "r.mcap")
    assert recording
    solve(folder / "r.mcap", recording, folder / "o.mcap", lambda _done, _total: None, compiled=False)
    live, again = (read_answers(folder / name) for name in ("r.mcap", "o.mcap"))
    for rows in (live, again):
        rows["status"] &= ~np.uint8(Status.INPUT_REJECTED)  # no refused sample is in a recording
    different = [name for name in TOLD if not np.array_equal(live.view(FLAT)[name], again.view(FLAT)[name])]
    return different if len(live) > 40 else ["length"]


@pytest.mark.parametrize("seed", range(8))
def test_solve_gives_the_bits_of_the_run(tmp_path: Path, seed: int) -> None:
    """Thousands of such runs are in `studies.live`."""
    walk(random.Random(seed), tmp_path / "r.mcap")
    assert not different_fields(tmp_path)
