"""What the grid shows, and checks of it."""

from __future__ import annotations

import warnings
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np

from knee_contact_ros import load_model
from knee_contact_ros.lab.sweep import outcomes
from knee_contact_ros.parameters.files import load_parameters
from studies.honesty.scenes import Scene
from studies.honesty.truth import reference
from studies.osteoarthritis.knees import (
    ARTHRITIC,
    FIRST,
    LAYER,
    NANOSECOND,
    SECOND,
    SHARE,
    SHIPPED,
    TOLERANCE,
    Floats,
    Grid,
    Knees,
    Table,
    along,
    equal_second,
    ratio,
    under_load,
)

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


SAME = 0.01
"""Part by which a peak force may differ from the healthy one and count as unchanged"""
ELASTIC = (
    (0.5e-3, SHIPPED.stiffness_2),
    (0.5e-3, FIRST),
    (0.25e-3, SHIPPED.stiffness_2),
    (3.0e-3, SHIPPED.stiffness_2),
)
"""Layers [m] and K₂ [N/m^1.5] of the few knees with the undamped law"""


class Range(NamedTuple):
    """Least and largest of some numbers."""

    least: float
    most: float


class Count(NamedTuple):
    """Numbers of knees whose peak force drops, stays within `SAME`, or rises."""

    drops: int
    stays: int
    rises: int


class Findings(NamedTuple):
    """Numbers of the page beside the tables."""

    forced: Count
    led: Count
    forced_range: Range
    """Ratios of the peak forces under the load"""
    damped_range: Range
    """Ratios of the peak forces under the load, with the dashpot in both layers"""
    led_range: Range
    impulses: Range
    """Impulses of the contact force over those of the load, under the load"""
    damped_impulses: Range
    unreached: Range
    """Ratios of led knees whose second layer is not reached"""
    reached: int
    """Number of knees of a drive whose layer is thinner than the healthy depth"""
    beside: int
    """Number of led knees whose drop or rise is not what the law at rest predicts"""
    beside_most: float
    """Largest change of force of these knees"""
    stiffer: int
    """Number of neighbouring led knees of which the stiffer one has less force"""
    flagged: int
    """Number of ticks of all runs beyond the tolerance"""
    ticks: int
    force_bound: float
    """Largest error estimate of a force [N]"""
    elastic: list[tuple[float, float, float, float]]
    """Layer [m], K₂, ratio of the peak forces under the load, and led"""
    alone: int
    """Number of knees computed one by one"""
    different: int
    """Number of their outcomes that are not the sweep's"""
    judged: list[Judged]
    momentum: list[Momentum]


def count(ratios: Floats) -> Count:
    """Count knees by the change of their peak force."""
    drops, rises = int(np.sum(ratios < 1.0 - SAME)), int(np.sum(ratios > 1.0 + SAME))
    return Count(drops, ratios.size - drops - rises, rises)


def find(knees: Knees) -> Findings:
    """Count the findings in all knees, and compute some knees again."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)  # a second layer softer than cartilage is asked for
        return _find(knees)


def _find(knees: Knees) -> Findings:
    forced, led, grid = ratio(knees, knees.forced), ratio(knees, knees.led), knees.grid
    depth = knees.healthy.peak_depth[:, None, None]
    reached = np.broadcast_to(grid.layers[None, :, None] < depth, grid.shape)
    damped = under_load(grid.values(), damp_first_layer=True).reshape(grid.shape).view(np.recarray)
    equal = np.stack([equal_second(grid.layers, float(one)) for one in knees.healthy.peak_depth])
    beside = reached & ((led > 1.0) != (grid.seconds > equal[..., None]))
    load = knees.healthy.impulse[:, None, None]
    cells = some(grid, min(100, led.size))
    return Findings(
        forced=count(forced), led=count(led), forced_range=_range(forced), led_range=_range(led),
        damped_range=_range(ratio(knees, damped)), impulses=_range(knees.forced.impulse / load),
        damped_impulses=_range(damped.impulse / load),
        unreached=_range(led[~reached]) if (~reached).any() else Range(np.nan, np.nan), reached=int(reached.sum()),
        beside=int(beside.sum()), beside_most=float(np.abs(led - 1.0)[beside].max(initial=0.0)),
        stiffer=int(np.sum(np.diff(knees.led.peak_force, axis=2) < 0.0)),
        flagged=int(knees.forced.not_converged.sum() + knees.led.not_converged.sum()),
        ticks=int(knees.forced.ticks.sum() + knees.led.ticks.sum()),
        force_bound=float(knees.forced.force_error_bound.max()), elastic=_elastic(knees), alone=len(cells),
        different=different(knees, cells), judged=[judged(knees, cell) for cell in cells[:20]],
        momentum=[momentum(knees, cell) for cell in (*cells[:4], _most_impulse(knees))],
    )  # fmt: skip


def _range(values: Floats) -> Range:
    return Range(float(values.min()), float(values.max()))


def _most_impulse(knees: Knees) -> Cell:
    off = np.abs(knees.forced.impulse / knees.healthy.impulse[:, None, None] - 1.0)
    a, b, c = np.unravel_index(int(off.argmax()), off.shape)
    return int(a), int(b), int(c)


def _elastic(knees: Knees) -> list[tuple[float, float, float, float]]:
    """Ratios of a few knees by Eq. 11 of the paper, at the first share."""
    layers, seconds = (np.array(column) for column in zip(*ELASTIC, strict=True))
    values = {SHARE: np.full(len(layers), knees.grid.shares[0]), LAYER: layers, SECOND: seconds}
    own: dict[str, Any] = {"law": "two_layer_elastic"}
    forced, led = under_load(values, **own), along(knees.paths[0], values, **own)
    peak = float(knees.healthy.peak_force[0])
    return [(layer, second, float(a) / peak, float(b) / peak) for (layer, second), a, b in
            zip(ELASTIC, forced.peak_force, led.peak_force, strict=True)]  # fmt: skip
