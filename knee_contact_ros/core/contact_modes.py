"""The smooth pieces of a contact law: apart, or in one layer and pressing, or in one layer and released.

A layer is released while its formula would pull (Kelvin-Voigt shortly before separation): cartilage cannot pull, so the
femur flies although the surfaces still overlap.
"""

from __future__ import annotations

from typing import NamedTuple

from knee_contact_ros.core.contact_laws.base import ContactLaw, layer_at
from knee_contact_ros.core.kernel_source import in_kernel

APART = -1
"""Layer of the mode in which the surfaces are apart"""
NOWHERE, ABOVE, FORCE, BELOW = -1, 0, 1, 2
"""Boundaries of a mode: none, the beginning of the layer, the change between pressing and released, the layer's end"""
BOUNDARIES = (ABOVE, FORCE, BELOW)

DEPTH_ROUNDING = 1e-13
"""Depth [m] by which a boundary must be crossed, else the crossing is rounding."""
FORCE_ROUNDING = 1e-10
"""Force by which a boundary must be crossed, as a part of the load (or of 1 N), else the crossing is rounding."""


class ContactMode(NamedTuple):
    """A smooth piece of the contact law."""

    layer: int
    """Index of the layer in the law; `APART` when the surfaces are apart"""
    pressing: bool
    """Whether the contact exerts force"""


class ContactModes(NamedTuple):
    """A contact law and whether it may pull; if it may not, its force is clamped at zero."""

    law: ContactLaw
    allow_tension: bool


class Entry(NamedTuple):
    """The mode that a contact enters, and force and slopes of its formula there."""

    mode: ContactMode
    force: float
    """Exerted force [N]; 0 unless pressing"""
    stiffness: float
    """Slope of the force over depth [N/m]"""
    damping: float
    """Slope of the force over rate [N s/m]"""


@in_kernel
def enter(modes: ContactModes, depth: float, rate: float, load: float, impact_speed: float) -> Entry:
    """Return the mode of a contact; on a layer's end, that of the side it moves to.

    It takes one evaluation of the law, none when apart.
    """
    layer = layer_at(modes.law, depth_ahead(depth, rate))
    return enter_layer(modes, layer, depth, rate, load, impact_speed)


@in_kernel
def enter_layer(modes: ContactModes, layer: int, depth: float, rate: float, load: float, impact_speed: float) -> Entry:
    """Return the mode of a contact in a given layer. It takes one evaluation of the law, none when apart."""
    if layer < 0:
        return Entry(ContactMode(APART, False), 0.0, 0.0, 0.0)
    force, stiffness, damping = modes.law.layers[layer].formula.force_at(depth, rate, impact_speed)
    if modes.allow_tension or force >= -force_rounding(load):
        return Entry(ContactMode(layer, True), force, stiffness, damping)
    return Entry(ContactMode(layer, False), 0.0, 0.0, 0.0)


@in_kernel
def switch(modes: ContactModes, mode: ContactMode, depth: float, rate: float, impact_speed: float) -> Entry:
    """Return the mode beyond the boundary `FORCE` of a mode: released if it was pressing, else pressing.

    It takes one evaluation of the law if the contact presses from now on, else none.
    """
    if mode.pressing:
        return Entry(ContactMode(mode.layer, False), 0.0, 0.0, 0.0)
    force, stiffness, damping = modes.law.layers[mode.layer].formula.force_at(depth, rate, impact_speed)
    return Entry(ContactMode(mode.layer, True), force, stiffness, damping)


@in_kernel
def event_function(modes: ContactModes, mode: ContactMode, boundary: int, depth: float, force: float) -> float:
    """Return the signed distance of a contact to a boundary of a mode, >= 0 inside: [m], or [N] for `FORCE`.

    It is infinite for a boundary that the mode does not have. `force` [N] is that of the layer's formula, not clamped.
    """
    layers = modes.law.layers
    if boundary == ABOVE and mode.layer >= 0:
        return depth - layers[mode.layer].begin
    if boundary == FORCE and mode.layer >= 0 and not modes.allow_tension:
        return force if mode.pressing else -force
    if boundary == BELOW and has_deeper(modes, mode):
        return layers[mode.layer + 1].begin - depth
    return float("inf")


@in_kernel
def has_deeper(modes: ContactModes, mode: ContactMode) -> bool:
    """Whether the law has another layer below that of a mode."""
    return mode.layer + 1 < len(modes.law.layers)


@in_kernel
def rounding(boundary: int, load: float) -> float:
    """Return the distance to a boundary that is taken as zero: [m], or [N] for `FORCE`; `load` [N]."""
    return force_rounding(load) if boundary == FORCE else DEPTH_ROUNDING


@in_kernel
def crossed(modes: ContactModes, mode: ContactMode, depth: float, force: float, load: float, known: int) -> int:
    """The first boundary of a mode that a contact lies beyond, except the `known` one; `NOWHERE` if it is inside."""
    for boundary in BOUNDARIES:
        if boundary != known and event_function(modes, mode, boundary, depth, force) < -rounding(boundary, load):
            return boundary
    return NOWHERE


@in_kernel
def depth_ahead(depth: float, rate: float) -> float:
    """Return a depth [m] moved by rounding in the direction of its rate, which decides the side of a layer's end."""
    return depth + (DEPTH_ROUNDING if rate >= 0.0 else -DEPTH_ROUNDING)


@in_kernel
def force_rounding(load: float) -> float:
    """Return the force [N] that is taken as zero under a load [N]."""
    return FORCE_ROUNDING * max(1.0, abs(load))
