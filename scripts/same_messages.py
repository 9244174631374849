"""Whether another checkout of this package gives the same messages, byte for byte.

python -m scripts.same_messages OTHER [--first N] [--scenes N]

Both compute the bundled bags with all shipped parameter files, and random scenes: laws, constants, surfaces, and
streams of two sensors some of whose samples are wrong. A checkout's .venv is used, and this Python where it has none.
Tells by how much depths and forces differ, and ends with 1 if anything does.
"""

from __future__ import annotations

import json
import math
import os
import subprocess
import sys
import tempfile
from concurrent.futures import ThreadPoolExecutor
from itertools import product
from pathlib import Path

import click
import numpy as np
from mcap.reader import make_reader
from ruamel.yaml import YAML

from knee_contact_ros.bags.answers import answer_topics, read_answers
from knee_contact_ros.bags.bag import Bag, RawMessage
from knee_contact_ros.model.types import UNUSABLE
from knee_contact_ros.streams.messages import (
    JointState,
    WrenchStamped,
    encode_joint_state,
    encode_wrench_stamped,
)
from studies.honesty.scenes import Scene, draw
from tests.helpers.bags import Mcap

ROOT = Path(__file__).parents[1]
SHIPPED = ("healthy", "osteoarthritis", "mri_femur", "mri_knee")
RUN = """
import importlib, json, sys
with open("pyproject.toml", encoding="utf-8") as file:
    (script,) = (line for line in file if line.startswith("knee-contact = "))
module, name = script.split('"')[1].split(":")
main = getattr(importlib.import_module(module), name)
print(json.dumps([main(["solve", *arguments]) for arguments in json.load(sys.stdin)]), file=sys.stderr)
"""


def scene_files(folder: Path, seed: int) -> list[str]:
    """Write a random bag and its parameters; give the arguments that `solve` takes."""
    scene = draw(seed)
    dice = np.random.default_rng(seed)
    base = ROOT / "config" / f"{dice.choice(SHIPPED)}.yaml"
    changes = {
        "contact": {"law": scene.law, "allow_tension": scene.allow_tension, **scene.arguments},
        "femur": {"mass": scene.mass},
        "fidelity": {
            "tolerance": float(10 ** dice.uniform(-9, -5)),
            "budget": int(dice.choice([0, 0, 100, 300])),
        },
    }
    path = folder / f"{seed}.yaml"
    with path.open("w", encoding="utf-8") as file:
        YAML(typ="safe").dump({"/**": {"ros__parameters": changes}}, file)
    bag = Mcap(folder / f"{seed}.mcap")
    channels = bag.channels()
    for message in random_messages(scene, dice):
        bag.write(channels[message.topic], message)
    bag.close()
    return [str(bag.path), "--params", str(base), "--params", str(path)]


def random_messages(scene: Scene, dice: np.random.Generator) -> list[RawMessage]:
    """Angles and forces with stamps of their own; one sample in 30 has a wrong number or stamp."""
    stamps = np.rint(1e9 * (1.0 + scene.time)).astype(np.int64).tolist()
    shift = int(dice.choice([0, 0, 1_300_000]))
    messages = []
    for stamp, value, axial in zip(stamps, scene.angle.tolist(), scene.load.tolist(), strict=True):
        late, ahead = (
            int(dice.choice([0, -50_000_000, 5_000_000_000])) if dice.random() < 1 / 60 else 0
            for _ in "ab"
        )
        number = float(dice.choice([np.nan, 1e9])) if dice.random() < 1 / 60 else value
        angles = JointState(stamp + shift + late, "", ("knee",), (number,), (), ())
        forces = WrenchStamped(stamp + ahead, "tibia_r", (0.0, -2.0 * axial, 0.0), (0.0, 0.0, 0.0))
        messages += [
            RawMessage("/joint_states", stamp, encode_joint_state(angles)),
            RawMessage("/joint_reaction_force", stamp, encode_wrench_stamped(forces)),
        ]
    return messages


def solved(checkout: Path, every: list[list[str]], folder: Path) -> list[int]:
    """Solve all bags with a checkout; return its exit codes."""
    folder.mkdir()
    jobs = [
        [*arguments, "--output", str(folder / f"{number}.mcap")]
        for number, arguments in enumerate(every)
    ]
    own = checkout.absolute() / ".venv" / "bin" / "python"
    command = [str(own) if own.exists() else sys.executable, "-c", RUN]
    path = os.environ | {
        "PYTHONPATH": str(checkout.absolute())
    }  # which comes before what is installed
    done = subprocess.run(
        command,
        cwd=checkout,
        env=path,
        input=json.dumps(jobs),
        capture_output=True,
        text=True,
        check=True,
    )
    codes: list[int] = json.loads(done.stderr.splitlines()[-1])
    return codes


def messages_of(path: Path) -> list[tuple[str, int, bytes]]:
    """Topic, stamp [ns] and bytes of all messages in a recording."""
    if not path.exists():
        return []
    with path.open("rb") as file:
        every = make_reader(file).iter_messages(log_time_order=False)
        return [(channel.topic, message.log_time, message.data) for _, channel, message in every]


def largest_differences(ours: Path, theirs: Path) -> tuple[float, float]:
    """Return the largest differences of depths [m] and of contact forces [N]; infinity where more differs.

    Answers that are flagged as unusable do not count: where the solver gives up, rounding decides what is left.
    """
    worst = [0.0, 0.0]
    with Bag(ours) as one, Bag(theirs) as other:
        if one.message_counts != other.message_counts:
            return math.inf, math.inf
        for topic in answer_topics(one):
            rows, others = read_answers(one, topic), read_answers(other, topic)
            unusable = (rows["status"] & others["status"] & UNUSABLE) > 0
            if not ((rows["status"] == others["status"]) | unusable).all():
                return math.inf, math.inf
            for number, name in enumerate(("penetration_depth", "contact_force")):
                apart = np.abs(rows[name] - others[name])
                same = (rows[name] == others[name]) | (
                    np.isnan(rows[name]) & np.isnan(others[name])
                )
                same |= unusable
                apart = np.where(same, 0.0, np.nan_to_num(apart, nan=math.inf))
                worst[number] = max(worst[number], float(np.max(apart, initial=0.0)))
    return worst[0], worst[1]


@click.command()
@click.argument("other", type=click.Path(path_type=Path, exists=True))
@click.option("--first", default=0, show_default=True, help="Scene to begin with.")
@click.option("--scenes", default=200, show_default=True, help="How many.")
def main(other: Path, first: int, scenes: int) -> None:
    """Compute with both checkouts, and compare the messages."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        bags = sorted(str(bag) for bag in (ROOT / "bags").iterdir() if bag.is_dir())
        shipped = [str(ROOT / "config" / f"{name}.yaml") for name in SHIPPED]
        lateral = ["--params", str(ROOT / "config" / "both_compartments.yaml")]
        jobs = [
            [bag, "--params", parameters, *more]
            for bag, parameters, more in product(bags, shipped, ([], lateral))
        ]
        jobs += [scene_files(folder, seed) for seed in range(first, first + scenes)]
        with ThreadPoolExecutor() as pool:
            codes = list(
                pool.map(solved, (ROOT, other), (jobs, jobs), (folder / "ours", folder / "theirs"))
            )
        messages = 0
        different = {}
        for number, arguments in enumerate(jobs):
            ours, theirs = (
                messages_of(folder / side / f"{number}.mcap") for side in ("ours", "theirs")
            )
            messages += len(ours)
            if ours != theirs or codes[0][number] != codes[1][number]:
                both = (folder / side / f"{number}.mcap" for side in ("ours", "theirs"))
                apart = largest_differences(*both) if ours and theirs else (math.inf, math.inf)
                different[" ".join(arguments)] = apart
        failed = sum(code != 0 for code in codes[0])
        click.echo(
            f"{len(jobs)} computations ({failed} refused), {messages} messages, {len(different)} different"
        )
        for arguments, (of_depth, of_force) in different.items():
            click.echo(f"{of_depth:.1g} m, {of_force:.1g} N: {arguments}")
    raise SystemExit(bool(different))


if __name__ == "__main__":
    main()
