"""How long a node takes to end by SIGTERM in mid-stream at 1 kHz, beside outputs that stand still and busy processes.

python -m studies.shutdown [--times N] [--output FILE]
"""

from __future__ import annotations

import itertools
import os
import signal
import tempfile
import time
from pathlib import Path

import click
import numpy as np
import rclpy

from benchmarks.report import Section, machine, save
from knee_contact_ros.system.ros import private_graph
from studies.cut_off import busy
from tests.ros.conftest import NodeProcess, Peer

STEP = 1_000_000
"""Time [ns] between two samples"""
BEFORE, AFTER = 1.5, 2.5
"""Time [s] of the stream before an output is stopped, and after it"""
OUTPUTS = ("recorder", "viewer")
TEXT = """\
The real node, recording to MCAP and drawing to a Rerun file, fed at 1 kHz for four seconds. After 1.5 s the process of
an output is stopped (SIGSTOP), at the end the node gets SIGTERM. Exit code 1: an output had to be given up, which the
log says. The aim is 5 s at most."""
HEADER = ("busy processes", "stopped", "times", "median [s]", "longest [s]", "exit codes")


def walk(peer: Peer, seconds: float) -> None:
    """Publish samples on schedule for a time [s]."""
    begin = time.monotonic()
    for number in range(round(seconds * 1e9 / STEP)):
        peer.send(time.monotonic_ns(), 0.2, 900.0)
        peer.spin(max(begin + number * 1e-9 * STEP - time.monotonic(), 0.0))


def end(stopped: str, folder: Path) -> tuple[float, int]:
    """Time [s] that a node takes to end, and its exit code."""
    peer, node = Peer(), NodeProcess(
        "-p", f"record.path:={folder}/knee.mcap", "-p", "rerun.mode:=file", "-p", f"rerun.path:={folder}/knee.rrd",
    )  # fmt: skip
    peer.wait_for_node()
    entries = [f"knee_contact: {output}" for output in OUTPUTS]
    peer.wait_until(lambda: all(peer.diagnostics.get(entry, {}).get("process", "none") != "none" for entry in entries))
    walk(peer, BEFORE)
    if stopped:
        os.kill(int(peer.diagnostics[f"knee_contact: {stopped}"]["process"]), signal.SIGSTOP)
    walk(peer, AFTER)
    begin = time.monotonic()
    code, _ = node.stop(signal.SIGTERM)
    took = time.monotonic() - begin
    peer.executor.shutdown()
    peer.node.destroy_node()
    return took, code


@click.command()
@click.option("--times", type=click.IntRange(1), default=5, show_default=True)
@click.option("--output", type=click.Path(path_type=Path), default=Path("docs/studies/shutdown.md"), show_default=True)
def main(times: int, output: Path) -> None:
    """Measure and write the table."""
    rows = []
    with private_graph() as environment:
        os.environ.update(environment)
        rclpy.init()
        for beside, stopped in itertools.product((0, 2), ("", *OUTPUTS)):
            ends = []
            for _ in range(times):
                with busy(beside), tempfile.TemporaryDirectory() as folder:
                    ends.append(end(stopped, Path(folder)))
            took, codes = zip(*ends, strict=True)
            told = ", ".join(map(str, sorted(set(codes))))
            rows.append(
                [str(beside), stopped or "nothing", str(times), f"{np.median(took):.1f}", f"{max(took):.1f}", told]
            )
            click.echo(" | ".join(rows[-1]), err=True)
        rclpy.shutdown()
    command = f"python -m studies.shutdown --times {times}"
    save(output, "The end of a node", command, [Section("", TEXT, HEADER, rows)], machine())


if __name__ == "__main__":
    main()
