"""What a second compartment costs: the same gait with one and with both, in turns in one process.

    python -m studies.compartments [--rounds 15]

One by one as live (decode, pair, compute, encode, what is recorded), and in blocks as `solve` takes them.
"""

from __future__ import annotations

import argparse
import statistics
from collections.abc import Callable
from time import perf_counter

import click

from benchmarks.report import machine
from knee_contact_ros.offline.bundled_gait import gait
from knee_contact_ros.offline.solve_blocks import take
from knee_contact_ros.parameters.files import load_parameters
from knee_contact_ros.streams.columns import Column
from knee_contact_ros.streams.contact_stream import ContactStream
from knee_contact_ros.streams.messages import JointState, WrenchStamped, encode_joint_state, encode_wrench_stamped

KNEES = {"circle on plane": ["healthy"], "MRI femur": ["healthy", "mri_femur"]}
STRIDES = 10
"""Number of times that the bundled gait is solved, each time from rest"""
MICROSECONDS = 1e6


def messages() -> tuple[list[bytes], list[bytes]]:
    """Joint states and forces of the bundled gait, serialised."""
    time, angles, halves = gait("right")
    stamps = (time * 1e9).astype(int).tolist()
    states = [
        encode_joint_state(JointState(stamp, "", ("knee",), (angle,), (), ()))
        for stamp, angle in zip(stamps, angles.tolist(), strict=True)
    ]
    forces = [
        encode_wrench_stamped(WrenchStamped(stamp, "tibia_r", (0.0, -2.0 * half, 0.0), (0.0, 0.0, 0.0)))
        for stamp, half in zip(stamps, halves.tolist(), strict=True)
    ]
    return states, forces


def live(pipeline: ContactStream, states: list[bytes], forces: list[bytes]) -> int:
    """Feed the messages to a pipeline as a node does, one by one."""
    ticks = 0
    for state, force in zip(states, forces, strict=True):
        for pairs in (pipeline.take_joint_state(state), pipeline.take_force(force)):
            for pair in pairs:
                pipeline.answer(pair, pipeline.compute(pair))
                ticks += 1
    return ticks


def offline(pipeline: ContactStream, states: list[bytes], forces: list[bytes]) -> int:
    """Feed the messages to a pipeline as `solve` does, in blocks."""
    first = live(pipeline, states[:2], forces[:2])
    taken = take(pipeline, Column.of(states[2:]), Column.of(forces[2:]))
    if taken is None:
        raise RuntimeError("the gait is not taken at once")
    return first + len(taken.rows[0])


def cost(
    way: Callable[[ContactStream, list[bytes], list[bytes]], int],
    pipelines: list[Callable[[], ContactStream]],
    rounds: int,
) -> list[float]:
    """Median time [s] of a tick of each pipeline, measured in turns."""
    states, forces = messages()
    times: list[list[float]] = [[] for _ in pipelines]
    for _ in range(rounds):
        for make, found in zip(pipelines, times, strict=True):
            spent, ticks = 0.0, 0
            for _ in range(STRIDES):
                pipeline = make()
                begin = perf_counter()
                ticks += way(pipeline, states, forces)
                spent += perf_counter() - begin
            found.append(spent / ticks)
    return [statistics.median(found) for found in times]


def main() -> None:
    """Measure and print the table."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--rounds", type=int, default=15)
    rounds = parser.parse_args().rounds
    click.echo(f"{machine('numba')}; medians of {rounds} rounds in turns")
    click.echo(f"{'':32}{'one [us]':>10}{'both [us]':>10}{'ratio':>8}")
    for name, files in KNEES.items():
        makers: list[Callable[[], ContactStream]] = []
        for more in ({}, {"load.compartment": "both"}):
            parameters = load_parameters([*files, more])
            ContactStream(parameters, compiled=True)
            makers.append(lambda parameters=parameters: ContactStream(parameters, compiled=True))  # type: ignore[misc]
        for way in (live, offline):
            one, both = cost(way, makers, rounds)
            title = f"{name}, {way.__name__}"
            click.echo(f"{title:32}{MICROSECONDS * one:10.2f}{MICROSECONDS * both:10.2f}{both / one:8.2f}")


if __name__ == "__main__":
    main()
