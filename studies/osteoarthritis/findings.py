"""Findings in the tables, as numbers for the page."""

from __future__ import annotations

import warnings
from typing import Any, NamedTuple

import numpy as np

from studies.osteoarthritis.checks import Cell, Judged, Momentum, different, judged, momentum, some
from studies.osteoarthritis.grid import FIRST, LAYER, SECOND, SHARE, SHIPPED, Floats
from studies.osteoarthritis.knees import Knees, along, under_load
from studies.osteoarthritis.theory import equal_second, ratio

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
