"""The smooth pieces of a contact law: apart, or in one layer and pressing, or in one layer and released.

A layer is released while its formula would pull (Kelvin-Voigt shortly before separation): cartilage cannot pull, so the
femur flies although the surfaces still overlap.
"""

from __future__ import annotations

from typing import NamedTuple

from knee_contact_ros.core.contact_laws.base import ContactLaw, LayerForce
from knee_contact_ros.core.integrators.base import Stage

DEPTH_ROUNDING = 1e-13
"""Crossings of less than this [m] are rounding."""
FORCE_ROUNDING = 1e-10
"""The same for the force, as a part of the load (or of 1 N)."""


class Region(NamedTuple):
    """A smooth piece of the contact law."""

    layer: int
    """Index into the law's layers; -1 when apart"""
    pressing: bool
    """Whether the contact exerts force"""


class Margin(NamedTuple):
    """A signed distance to one boundary of a region: >= 0 inside."""

    boundary: str
    """`above` and `below`: the layer's ends; `force`: the change between pressing and released"""
    value: float
    """[m] or [N]"""
    rounding: float
    """What counts as zero, in the same unit"""


class Regions(NamedTuple):
    """The regions of one law; clamped at zero force unless it may pull."""

    law: ContactLaw
    allow_tension: bool

    def after_impact(self, speed: float) -> Regions:
        """The regions of a contact that began at a speed of approach [m/s]."""
        return self if self.law.at_impact is None else self._replace(law=self.law.after_impact(speed))

    def formula(self, region: Region) -> LayerForce | None:
        """Formula of the region's layer; None when apart."""
        return self.law.layers[region.layer].force if region.layer >= 0 else None

    def at(self, depth: float, rate: float, load: float) -> Region:
        """Region of a contact; on a layer's end, the side it moves to."""
        ahead = depth_ahead(depth, rate)
        layer = sum(1 for layer in self.law.layers if layer.begin <= ahead) - 1
        return self.in_layer(layer, depth, rate, load)

    def in_layer(self, layer: int, depth: float, rate: float, load: float) -> Region:
        """Region of a contact in a given layer."""
        if layer < 0:
            return Region(-1, False)
        force = self.law.layers[layer].force(depth, rate)[0]
        return Region(layer, self.allow_tension or force >= -_force_rounding(load))

    def beyond(self, region: Region, boundary: str, end: Stage, load: float) -> Region:
        """Region behind the boundary on which a step has ended."""
        if boundary == "force":
            return Region(region.layer, not region.pressing)
        return self.in_layer(region.layer + (1 if boundary == "below" else -1), end.depth, end.rate, load)

    def margins(self, region: Region, stage: Stage, load: float) -> tuple[Margin, ...]:
        """Distances of a contact to the boundaries of a region."""
        layers = self.law.layers
        margins = []
        if region.layer >= 0:
            margins.append(Margin("above", stage.depth - layers[region.layer].begin, DEPTH_ROUNDING))
            if not self.allow_tension:
                inside = stage.force if region.pressing else -stage.force
                margins.append(Margin("force", inside, _force_rounding(load)))
        if region.layer + 1 < len(layers):
            margins.append(Margin("below", layers[region.layer + 1].begin - stage.depth, DEPTH_ROUNDING))
        return tuple(margins)


def depth_ahead(depth: float, rate: float) -> float:
    """The depth [m] that a contact on a layer's end is about to have: it decides on which side of it."""
    return depth + (DEPTH_ROUNDING if rate >= 0.0 else -DEPTH_ROUNDING)


def _force_rounding(load: float) -> float:
    return FORCE_ROUNDING * max(1.0, abs(load))
