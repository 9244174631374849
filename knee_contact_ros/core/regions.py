"""The smooth pieces of a contact law: apart, or in one layer and pressing, or in one layer and released.

A layer is released while its formula would pull (Kelvin-Voigt shortly before separation): cartilage cannot pull, so the
femur flies although the surfaces still overlap.
"""

from __future__ import annotations

from typing import NamedTuple

from knee_contact_ros.core.contact_laws.base import ContactLaw, layer_at
from knee_contact_ros.core.kernel_source import in_kernel

APART = -1
"""The layer when apart"""
NOWHERE, ABOVE, FORCE, BELOW = -1, 0, 1, 2
"""Boundaries of a region: none; the layer's upper and lower end; the change between pressing and released"""
BOUNDARIES = (ABOVE, FORCE, BELOW)

DEPTH_ROUNDING = 1e-13
"""Crossings of less than this [m] are rounding."""
FORCE_ROUNDING = 1e-10
"""The same for the force, as a part of the load (or of 1 N)."""


class Region(NamedTuple):
    """A smooth piece of the contact law."""

    layer: int
    """Index into the law's layers; `APART` when apart"""
    pressing: bool
    """Whether the contact exerts force"""


class Regions(NamedTuple):
    """The regions of one law; clamped at zero force unless it may pull."""

    law: ContactLaw
    allow_tension: bool


class Entry(NamedTuple):
    """The region that a contact is in, and what its formula gives there."""

    region: Region
    force: float
    """[N] exerted: 0 unless pressing"""
    stiffness: float
    """Its slope over depth [N/m]"""
    damping: float
    """Its slope over rate [N s/m]"""


@in_kernel
def enter(regions: Regions, depth: float, rate: float, load: float, impact_speed: float) -> Entry:
    """Region of a contact; on a layer's end, the side it moves to. One evaluation, none when apart."""
    layer = layer_at(regions.law, depth_ahead(depth, rate))
    return enter_layer(regions, layer, depth, rate, load, impact_speed)


@in_kernel
def enter_layer(regions: Regions, layer: int, depth: float, rate: float, load: float, impact_speed: float) -> Entry:
    """Region of a contact in a given layer. One evaluation, none when apart."""
    if layer < 0:
        return Entry(Region(APART, False), 0.0, 0.0, 0.0)
    force, stiffness, damping = regions.law.layers[layer].formula.force_at(depth, rate, impact_speed)
    if regions.allow_tension or force >= -force_rounding(load):
        return Entry(Region(layer, True), force, stiffness, damping)
    return Entry(Region(layer, False), 0.0, 0.0, 0.0)


@in_kernel
def cross_force(regions: Regions, region: Region, depth: float, rate: float, impact_speed: float) -> Entry:
    """Region behind the boundary `FORCE` of a region: released if it was pressing. One evaluation, or none."""
    if region.pressing:
        return Entry(Region(region.layer, False), 0.0, 0.0, 0.0)
    force, stiffness, damping = regions.law.layers[region.layer].formula.force_at(depth, rate, impact_speed)
    return Entry(Region(region.layer, True), force, stiffness, damping)


@in_kernel
def margin(regions: Regions, region: Region, boundary: int, depth: float, force: float) -> float:
    """Signed distance of a contact to a boundary of a region: >= 0 inside; [m], or [N] for `FORCE`.

    Infinite for a boundary that the region does not have. `force` [N] is that of the layer's formula, not clamped.
    """
    layers = regions.law.layers
    if boundary == ABOVE and region.layer >= 0:
        return depth - layers[region.layer].begin
    if boundary == FORCE and region.layer >= 0 and not regions.allow_tension:
        return force if region.pressing else -force
    if boundary == BELOW and region.layer + 1 < len(layers):
        return layers[region.layer + 1].begin - depth
    return float("inf")


@in_kernel
def rounding(boundary: int, load: float) -> float:
    """What counts as a margin of zero."""
    return force_rounding(load) if boundary == FORCE else DEPTH_ROUNDING


@in_kernel
def crossed(regions: Regions, region: Region, depth: float, force: float, load: float, known: int) -> int:
    """The first boundary of a region that a contact lies beyond, except the `known` one; `NOWHERE` if it is inside."""
    for boundary in BOUNDARIES:
        if boundary != known and margin(regions, region, boundary, depth, force) < -rounding(boundary, load):
            return boundary
    return NOWHERE


@in_kernel
def depth_ahead(depth: float, rate: float) -> float:
    """The depth [m] that a contact on a layer's end is about to have: it decides on which side of it."""
    return depth + (DEPTH_ROUNDING if rate >= 0.0 else -DEPTH_ROUNDING)


@in_kernel
def force_rounding(load: float) -> float:
    """What counts as no force [N]."""
    return FORCE_ROUNDING * max(1.0, abs(load))
