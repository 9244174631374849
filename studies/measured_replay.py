"""A measured knee through the real node: imported, aligned, replayed, recorded, viewed and reported.

python -m studies.measured_replay TRIALS [--noise DEG] [--jitter MS] [--output FILE] [--keep FOLDER]

TRIALS is the folder with `ngait_tm_fast1_motion.csv` and `ngait_tm_fast1_tibia_cells.csv`, of the knee load competition
(Fregly et al. 2012, doi:10.1002/jor.22023); they are not ours to pass on.
"""

from __future__ import annotations

import math
import os
import subprocess
import sys
import tempfile
from collections import Counter
from pathlib import Path
from typing import NamedTuple

import click
import numpy as np
import rclpy

from benchmarks.report import Section, machine, save
from knee_contact_ros.bags.reader import INPUT_TYPES, BagReader, RawMessage, answer_blocks, metadata_records
from knee_contact_ros.bags.recorder import REFUSED_SAMPLES, BagWriter
from knee_contact_ros.commands.main import main as knee_contact
from knee_contact_ros.model.types import Rows, Status
from knee_contact_ros.offline.notebooks import solve
from knee_contact_ros.parameters.files import load_parameters
from knee_contact_ros.streams.messages import JOINT_STATE, encode_joint_state
from knee_contact_ros.system.errors import UsageError
from knee_contact_ros.system.ros import private_graph
from tests.ros.conftest import NodeProcess, Peer

TRIAL = "ngait_tm_fast1"
MAP = """\
time: {column: time_s}
angle: {column: goniometer_deg, unit: deg}
reference: {column: knee_flexion_deg, unit: deg, sign: -1}
load:
  columns: {pm_n: 1, am_n: 1, al_n: 1, pl_n: 1}
  unit: N
body_weight: 654.3
"""
LOST, NO_NUMBER, LATE = 0.01, 0.005, 0.005
"""Parts of the angles that are lost, not a number, or stamped before the last one"""
BACK = 12_000_000
"""Time [ns] by which a late angle's stamp lies back: more than a step at 120 Hz"""
SEED = 21
DEADLINE = 0.05
TEXT = """
{rows} forces and as many goniometer angles at 120 Hz, {seconds:.1f} s, of a person with an instrumented knee on a
treadmill (Fregly et al. 2012, doi:10.1002/jor.22023), made a bag by `import-csv` and aligned with motion capture by
`align`: {offset:.2f} degrees, {lag:.1f} ms late. `knee-contact replay` plays it at its own pace into the real node
(`healthy.yaml` and the parameters found, `deadline` {deadline} s), which records it and draws it into a Rerun file;
the recording is computed again, reported and viewed. *Disturbed* are the angles: noise of {noise:g} degrees, stamps
moved by up to ±{jitter:g} ms, one in a hundred lost, one in two hundred not a number, and one in two hundred stamped
{back} ms back. Depth is the model's (an implant is polyethylene on metal): what is tried here is a real stream's way.

A force waits for an angle that comes {lag:.0f} ms later, and for the next row: no answer can come sooner. *As by
solve*: answers to the same bag that have the same bits in all fields but `status`; likewise those to the recording. Its
status lacks what was refused, as that is not recorded.
"""
HEADER = (
    "stream", "ticks", "flagged", "refused samples", "missed deadlines", "as by solve", "recording computed again",
    "files [MB]",
)  # fmt: skip


class Run(NamedTuple):
    """Result of a replay."""

    ticks: int
    flagged: dict[str, int]
    refused: dict[str, int]
    missed: str
    same: int
    """Number of answers that equal those of `solve`, bit by bit but for the status"""
    again: int
    """Number of answers that equal those of the recording computed again"""
    shown: str


@click.command()
@click.argument("trials", type=click.Path(path_type=Path))
@click.option("--noise", default=0.5, show_default=True, help="Standard deviation of the angle's noise [deg].")
@click.option("--jitter", default=2.0, show_default=True, help="Largest shift of an angle's stamp [ms].")
@click.option(
    "--output", default=Path("docs/studies/measured_replay.md"), show_default=True, type=click.Path(path_type=Path)
)
@click.option("--keep", type=click.Path(path_type=Path), help="Folder for recordings, Rerun files and reports.")
def main(trials: Path, noise: float, jitter: float, output: Path, keep: Path | None) -> None:
    """Replay and write the page; without the trials, say so and do nothing."""
    if not (trials / f"{TRIAL}_tibia_cells.csv").exists():
        click.echo(f"{trials} has no {TRIAL}_tibia_cells.csv: nothing to replay")
        return
    with tempfile.TemporaryDirectory() as temporary, private_graph() as environment:
        os.environ.update(environment)
        folder = keep or Path(temporary)
        folder.mkdir(parents=True, exist_ok=True)
        bag, overlay = prepared(trials, folder)
        rclpy.init()
        runs = {
            "as measured": replayed(bag, overlay, folder / "measured"),
            "disturbed": replayed(
                disturbed(bag, folder / "disturbed.mcap", noise, jitter), overlay, folder / "disturbed"
            ),
        }
        rclpy.shutdown()
        found = load_parameters(overlay)
        messages = stamps(bag)
    text = TEXT.format(
        rows=len(messages), seconds=1e-9 * (messages[-1] - messages[0]), offset=math.degrees(found.knee.flexion_offset),
        lag=1e3 * found.pairing.angle_delay, deadline=DEADLINE, noise=noise, jitter=jitter, back=BACK // 1_000_000,
    )  # fmt: skip
    section = Section("", text, HEADER, [row(name, run) for name, run in runs.items()])
    save(output, "A measured knee through the node", "python -m studies.measured_replay TRIALS", [section], machine())


def command(*arguments: str | Path) -> None:
    """Run a command of `knee-contact`.

    Raises:
        UsageError: it did not end well.
    """
    code = knee_contact([str(argument) for argument in arguments])
    if code:
        raise UsageError(f"knee-contact {' '.join(map(str, arguments))} ended with {code}")


def prepared(trials: Path, folder: Path) -> tuple[Path, Path]:
    """Import the trials as a bag, with the parameters that align its angle."""
    map_file = folder / "map.yaml"
    map_file.write_text(MAP, encoding="utf-8")
    files = [trials / f"{TRIAL}_{part}.csv" for part in ("motion", "tibia_cells")]
    command("import-csv", *files, "--map", map_file, "--output", folder / "bag", "--overwrite")
    command("align", *files, "--map", map_file, "--output", folder / "align.yaml", "--overwrite")
    return folder / "bag", folder / "align.yaml"


def stamps(bag: Path) -> list[int]:
    """Stamps of the forces in a bag [ns]."""
    with BagReader(bag, INPUT_TYPES) as reader:
        return [message.log_time for message in reader.raw_messages(("/joint_reaction_force",))]


def disturbed(bag: Path, path: Path, noise: float, jitter: float) -> Path:
    """Write a bag whose angles have noise [deg], jitter [ms] and faults, each at its time in the old bag."""
    random = np.random.default_rng(SEED)
    with BagReader(bag, INPUT_TYPES) as reader, BagWriter(path, overwrite=True) as written:
        for topic, name in INPUT_TYPES.items():
            written.add_topic(topic, name)
        for message in reader.raw_messages():
            data = message.data if message.topic != "/joint_states" else spoilt(message, random, noise, jitter)
            if data:
                written.write(message.topic, message.log_time, data)
    return path


def spoilt(message: RawMessage, random: np.random.Generator, noise: float, jitter: float) -> bytes:
    """An angle as a worse sensor would have sent it; none if it is lost."""
    decoded = JOINT_STATE.decode(message.data)
    assert decoded is not None  # noqa: S101  (ours)
    state, kind = decoded[0], random.random()
    angle = state.position[0] + math.radians(noise) * random.normal()
    stamp = max(0, state.stamp + round(1e6 * jitter * random.uniform(-1.0, 1.0)))
    if kind < LOST:
        return b""
    if kind < LOST + NO_NUMBER:
        angle = math.nan
    elif kind < LOST + NO_NUMBER + LATE:
        stamp = max(0, state.stamp - BACK)
    return encode_joint_state(state._replace(stamp=stamp, position=(angle,)))


def replayed(bag: Path, overlay: Path, folder: Path) -> Run:
    """Play a bag into the node, and measure what it recorded."""
    folder.mkdir(exist_ok=True)
    recording = folder / "live.mcap"
    for old in (recording, folder / "live.rrd", folder / "metadata.yaml"):
        old.unlink(missing_ok=True)
    values = {"body_weight": 654.3, "deadline": DEADLINE, "record.path": recording, "rerun.mode": "file",
              "rerun.path": folder / "live.rrd"}  # fmt: skip
    peer = Peer()
    healthy = Path(__file__).parents[1] / "config" / "healthy.yaml"
    words = [word for name, value in values.items() for word in ("-p", f"{name}:={value}")]
    node = NodeProcess("--params-file", str(healthy), "--params-file", str(overlay), *words)
    peer.wait_for_node()
    replay = subprocess.Popen(
        [sys.executable, "-m", "knee_contact_ros.commands.main", "replay", str(bag), "--wait", "60"]
    )
    peer.wait_until(lambda: replay.poll() is not None)
    peer.spin(2.5)
    missed = next(values["missed deadlines"] for values in peer.diagnostics.values() if "missed deadlines" in values)
    node.stop()
    peer.executor.shutdown()
    peer.node.destroy_node()
    live = answers(recording)
    params = ["healthy.yaml", str(overlay)]
    offline, again = folder / "offline.mcap", folder / "again.mcap"
    solve(bag, params, {"body_weight": 654.3}, output=offline, overwrite=True)
    command("solve", recording, "--output", again, "--overwrite")
    command("report", recording, "--output", folder / "report")
    command("view", recording, "--save", folder / "seen.rrd", "--overwrite")
    sizes = [(folder / name).stat().st_size / 1e6 for name in ("report/report.html", "seen.rrd", "live.rrd")]
    return Run(
        len(live), flags(live), refusals(recording), missed, same(live, answers(offline)), same(live, answers(again)),
        "report {:.1f}, view {:.1f}, live view {:.1f}".format(*sizes),
    )  # fmt: skip


def answers(recording: Path) -> Rows:
    """All answers in a recording, a row each."""
    return np.concatenate(list(answer_blocks(recording)))


def same(live: Rows, other: Rows) -> int:
    """Number of answers with the same bits, matched by their stamps; the status does not count."""
    names = [name for name in live.dtype.names or () if name not in ("status", "latency")]
    theirs = {int(stamp): number for number, stamp in enumerate(other["stamp"])}
    return sum(
        all(answer[name].tobytes() == other[theirs[int(answer["stamp"])]][name].tobytes() for name in names)
        for answer in live
        if int(answer["stamp"]) in theirs
    )


def flags(live: Rows) -> dict[str, int]:
    """Number of ticks by status bit."""
    counted = {str(bit.name): int(np.count_nonzero(live["status"] & int(bit))) for bit in Status if int(bit)}
    return {name: number for name, number in counted.items() if number}


def refusals(recording: Path) -> dict[str, int]:
    """Number of refused samples by reason, as the recording states it."""
    counted: Counter[str] = Counter()
    for record in metadata_records(recording):
        if record.name == REFUSED_SAMPLES:
            counted.update({reason: int(number) for reason, number in record.metadata.items() if reason != "total"})
    return dict(counted)


def row(name: str, run: Run) -> tuple[str, ...]:
    """Row of the table for a replay."""
    return (
        name, str(run.ticks), listed(run.flagged), listed(run.refused), run.missed, f"{run.same} of {run.ticks}",
        f"{run.again} of {run.ticks}", run.shown,
    )  # fmt: skip


def listed(counted: dict[str, int]) -> str:
    """Format counts with their names."""
    return ", ".join(f"{number} {name}" for name, number in counted.items()) or "none"


if __name__ == "__main__":
    main()
