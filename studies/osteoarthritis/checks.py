"""Checks of some knees: computed one by one, by the reference that shares no code, and by their momenta."""

from __future__ import annotations

from itertools import pairwise
from typing import NamedTuple

import numpy as np

from knee_contact_ros import load_model
from knee_contact_ros.lab.sweep import outcomes
from knee_contact_ros.parameters.files import load_parameters
from studies.honesty.scenes import Scene
from studies.honesty.truth import reference
from studies.osteoarthritis.grid import ARTHRITIC, LAYER, SECOND, SHARE, Grid
from studies.osteoarthritis.knees import NANOSECOND, TOLERANCE, Knees, Table

Cell = tuple[int, int, int]
NOT_OF_SERIES = {"peak_pressure", "peak_strain"}
"""Outcomes that need more than the answers of a run"""
COMPILED = True
"""Whether single runs are compiled: the same bits, quicker where there are many"""
FINE = 1e-5
"""Step [s] with which a force is integrated; the load is linear between the recorded samples either way"""


class Judged(NamedTuple):
    """Differences of a run under the load from the reference."""

    depth: float
    """Largest difference of the depth [m]"""
    force: float
    """Largest difference of the force [N]"""
    bound: float
    """Bound of the reference's own error of the depth [m]"""


class Momentum(NamedTuple):
    """Impulses [N s] of a knee under the load, integrated in small steps."""

    load: float
    """Impulse of the load"""
    excess: float
    """Impulse of the contact force less that of the load"""
    gained: float
    """Gain of momentum, M (ẏ at the end - ẏ at the beginning)"""


def some(grid: Grid, number: int, seed: int = 22) -> list[Cell]:
    """Draw a number of cells of a grid."""
    return [(int(a), int(b), int(c)) for a, b, c in np.random.default_rng(seed).integers(0, grid.shape, (number, 3))]


def values_at(grid: Grid, cell: Cell) -> dict[str, float]:
    """Parameters of a cell of a grid."""
    return {name: float(axis[place]) for name, axis, place in zip((SHARE, LAYER, SECOND), grid, cell, strict=True)}


def run(knees: Knees, cell: Cell, drive: str) -> Table:
    """Run one knee alone under a drive."""
    path = knees.paths[cell[0]]
    model = load_model([ARTHRITIC, {**values_at(knees.grid, cell), **TOLERANCE, "drive": drive}], compiled=COMPILED)
    heights = path.femoral_height if drive == "displacement" else None
    return model.run(path.stamp * NANOSECOND, path.flexion_angle, path.load, heights)


def different(knees: Knees, cells: list[Cell]) -> int:
    """Number of outcomes of knees alone, under both drives, that differ from the sweep's in any bit."""
    found = 0
    for cell in cells:
        for table, drive in ((knees.forced, "force"), (knees.led, "displacement")):
            series = run(knees, cell, drive)
            steps = np.diff(series.stamp, prepend=series.stamp[:1]) * NANOSECOND
            law = load_model([ARTHRITIC, values_at(knees.grid, cell)]).law
            own = outcomes(np.asarray(series)[None], steps, [law], [None])[0]
            names = set(own.dtype.names or ()) - NOT_OF_SERIES
            found += sum(bool(table[cell][name] != own[name]) for name in names)
    return found


def judged(knees: Knees, cell: Cell) -> Judged:
    """Compare a knee under the load with the reference."""
    path, asked = knees.paths[cell[0]], load_parameters([ARTHRITIC, values_at(knees.grid, cell)])
    names = ("stiffness", "exponent", "damping", "layer_depth", "stiffness_2", "damp_first_layer")
    law = {name: getattr(asked.contact, name) for name in names}
    axes, time = (asked.femur.radius, asked.femur.radius), path.stamp * NANOSECOND
    scene = Scene(
        0, "gait", asked.contact.law, law, asked.femur.mass, axes, 0.0, asked.contact.allow_tension, "recorded", time,
        np.array(path.flexion_angle), np.array(path.load),
    )  # fmt: skip
    series, truth = run(knees, cell, "force"), reference(scene)
    depth = np.abs(series.penetration_depth - series.gap - truth.depth).max()
    return Judged(float(depth), float(np.abs(series.contact_force - truth.force).max()), float(truth.depth_bound.max()))


def momentum(knees: Knees, cell: Cell, step: float = FINE) -> Momentum:
    """Integrate the impulses of a knee under the load, with a step [s]."""
    path = knees.paths[cell[0]]
    time = path.stamp * NANOSECOND
    parts = max(1, round(float(np.diff(time).min()) / step))
    fine = np.unique(np.concatenate([np.linspace(a, b, parts + 1) for a, b in pairwise(time)]))
    angle, load = np.interp(fine, time, path.flexion_angle), np.interp(fine, time, path.load)
    model = load_model([ARTHRITIC, {**values_at(knees.grid, cell), **TOLERANCE}], compiled=COMPILED)
    series = model.run(fine, angle, load)
    steps = np.diff(fine)

    def impulse(force: Table) -> float:
        return float(np.sum(0.5 * (force[1:] + force[:-1]) * steps))

    rate = series.penetration_rate  # of the depth: -ẏ for a circle on a level plane
    return Momentum(
        impulse(load), impulse(series.contact_force) - impulse(load), float(model.mass * (rate[0] - rate[-1]))
    )
