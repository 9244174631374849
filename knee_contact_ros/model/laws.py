"""Contact laws: the normal force [N] from penetration depth δ [m] and rate δ̇ [m/s], one smooth formula per layer.

All laws of the package are rows of constants in one formula (`COMMON`), δ counted in the whole contact:

    F(δ, δ̇) = F₀ + K (δ - h)ⁿ (1 + D δ̇ / max(v₀, v_least)) + C δ̇

with h the depth at which the layer begins, F₀ the force of the layers above at h, and v₀ the penetration rate at which
the contact began. Eqs. 8 to 12 of the paper are such rows.

To add a law, write its factory here: the keyword arguments are the `contact.*` parameters that it uses, and a constant
that no other law has gets a `Range` and a default. Then name it in `CONTACT_LAWS`, and give it a row in
docs/explanation/model.md.
A formula that is not a row of the common one is a separate function, marked `in_kernel`, with its own value of
`Layer.form`, by which `force_at` calls it. `ContactLaw` says what every formula must fulfil.
"""

import math
import sys
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from .compiler import in_kernel
from .types import Floats

APART = 0
"""Row of the kernel's array for surfaces that are apart, without force; the layers follow from row 1"""
COMMON = 0.0
"""Form of the layers whose force is the common formula"""
_MAX_DEPTH = 1e30
"""Limit of depths [m], which prevents overflow; larger ones occur only in trial steps of an integrator"""
_NO_FLOOR = sys.float_info.min
"""Floor [m/s] under the impact speed where none is needed: not 0, as the speed is a divisor"""


class Range(NamedTuple):
    """Range of a law's own constant, in the signature of its factory: `edge: Annotated[float, Range(...)] = 0.001`."""

    least: float
    most: float
    meaning: str
    """Description of the parameter with its unit, for users"""


class Layer(NamedTuple):
    """One layer of a contact law: its constants in the common formula."""

    begin: float = 0.0
    """Depth h [m] at which the layer begins; 0 for the first layer"""
    base: float = 0.0
    """Force F₀ [N] of the layers above at h"""
    stiffness: float = 0.0
    """K [N/mⁿ]"""
    exponent: float = 1.5
    """n, 1 to 3"""
    damping: float = 0.0
    """C [N s/m]"""
    loss: float = 0.0
    """D; unless it is 0, the force depends on the impact speed"""
    least_impact_speed: float = _NO_FLOOR
    """Floor v_least [m/s] under the impact speed, > 0"""
    form: float = COMMON
    """Formula: `COMMON`, or the number of a separate function"""

    def force_at(
        self, depth: float, rate: float, impact_speed: float = 0.0
    ) -> tuple[float, float, float]:
        """Return the force [N] of the layer's formula and its slopes over depth [N/m] and rate [N s/m], not clamped."""
        return force_at(np.array([self]), 0, depth, rate, impact_speed)


# Columns of a law's array for the kernel
BEGIN = Layer._fields.index("begin")
BASE = Layer._fields.index("base")
_STIFFNESS = Layer._fields.index("stiffness")
EXPONENT = Layer._fields.index("exponent")
DAMPING = Layer._fields.index("damping")
_LOSS = Layer._fields.index("loss")
_LEAST_SPEED = Layer._fields.index("least_impact_speed")


@in_kernel
def force_at(
    law: Floats, layer: int, depth: float, rate: float, impact_speed: float
) -> tuple[float, float, float]:
    """Return the force [N] of a layer's formula and its slopes over depth [N/m] and rate [N s/m], not clamped.

    `law` is `ContactLaw.rows`. Depth [m] and rate [m/s] are those of the penetration; `impact_speed` [m/s] is the
    rate at first touch, 0 for a contact that began at rest.
    """
    depth_in_layer = depth - float(law[layer, BEGIN])
    damping = float(law[layer, DAMPING])
    elastic = 0.0
    slope = 0.0
    if depth_in_layer > 0.0:
        exponent = float(law[layer, EXPONENT])
        depth_in_layer = min(depth_in_layer, _MAX_DEPTH)
        # The usual exponent takes a square root, which is faster than a power.
        root = exponent == 1.5
        power = math.sqrt(depth_in_layer) if root else depth_in_layer ** (exponent - 1.0)
        secant = float(law[layer, _STIFFNESS]) * power
        elastic = secant * depth_in_layer
        slope = exponent * secant
    loss = float(law[layer, _LOSS])
    if loss != 0.0:
        loss /= max(impact_speed, float(law[layer, _LEAST_SPEED]))
        damping += elastic * loss
        slope *= 1.0 + loss * rate
    return float(law[layer, BASE]) + elastic + damping * rate, slope, damping


@in_kernel
def layer_at(law: Floats, depth: float) -> int:
    """Return the row of the layer at a depth [m], or `APART`; exactly at the beginning of a layer, that layer."""
    index = APART
    while law[index + 1, BEGIN] <= depth:
        index += 1
    return index


@in_kernel
def law_force(
    law: Floats, depth: float, rate: float, impact_speed: float
) -> tuple[float, float, float]:
    """Return force and slopes as `force_at` does, in the layer of the depth [m]; 0 when apart.

    Exactly at the beginning of a layer they are those of the layer before.
    """
    index = APART
    while law[index + 1, BEGIN] < depth:
        index += 1
    return force_at(law, index, depth, rate, impact_speed)


@dataclass(frozen=True)
class ContactLaw:
    """Normal contact force as a function of penetration depth and rate, layer by layer.

    The first layer begins at 0 m, and each other layer deeper than the one before. A formula is smooth within its layer
    and continues smoothly beyond its ends. The static force is 0 at depth 0, continuous between layers, and does not
    fall with the depth; nor does its slope within a layer (the formula is convex, n >= 1). So there is one static
    depth, and Newton's method solves an implicit stage from anywhere. With a rate the force is F₀(δ) + c(δ) δ̇ with c
    >= 0. It is not clamped: where a formula pulls, the solver releases the contact.
    """

    layers: tuple[Layer, ...]
    """The layers in the order of their depths"""
    thickness: float = math.inf
    """Thickness [m] of the modelled material, above which a depth is implausible; infinite if unknown"""

    @cached_property
    def rows(self) -> Floats:
        """The constants as the kernel takes them, shape (layers + 2, 8).

        The first row is that of surfaces that are apart, the last one a layer that no depth reaches.
        """
        return np.array([Layer(-math.inf), *self.layers, Layer(math.inf)], dtype=np.float64)

    @property
    def remembers_impact(self) -> bool:
        """Whether the force depends on the penetration rate at which the contact began."""
        return any(layer.loss != 0.0 for layer in self.layers)

    def force_at(
        self, depth: float, rate: float, impact_speed: float = 0.0
    ) -> tuple[float, float, float]:
        """Return force [N] and slopes [N/m], [N s/m] in the layer of a depth [m], not clamped; 0 when apart."""
        return law_force(self.rows, depth, rate, impact_speed)

    def static_force(self, depth: float) -> float:
        """Return the force [N] at rest at a depth [m]; 0 when apart."""
        return self.force_at(depth, 0.0)[0]


def hertz(*, stiffness: float, exponent: float) -> ContactLaw:
    """Return the elastic law F = K δⁿ (Eq. 8 with C = 0): `stiffness` K [N/mⁿ], `exponent` n (1.5: two curved solids).

    Source: Hertz 1882, doi:10.1515/crll.1882.92.156. Valid for small, frictionless contacts of elastic solids. This law
    has no damping: the knee keeps ringing about its equilibrium.
    """
    return ContactLaw((Layer(stiffness=stiffness, exponent=exponent),))


def kelvin_voigt(*, stiffness: float, exponent: float, damping: float) -> ContactLaw:
    """Return the paper's law F = K δⁿ + C δ̇ (Eqs. 8, 10): `stiffness` K [N/mⁿ], `exponent` n, `damping` C [N s/m].

    The force jumps by C δ̇ at first touch, and the formula pulls shortly before separation.
    """
    return ContactLaw((Layer(stiffness=stiffness, exponent=exponent, damping=damping),))


def two_layer_elastic(
    *, stiffness: float, exponent: float, layer_depth: float, stiffness_2: float
) -> ContactLaw:
    """Return cartilage on bone, elastic (Eq. 11): K₁ δⁿ up to `layer_depth` h [m], then K₁ hⁿ + K₂ (δ - h)ⁿ.

    `stiffness` is K₁ and `stiffness_2` K₂ [N/mⁿ]. The stiffness jumps at h. The law has no damping.
    """
    cartilage = Layer(stiffness=stiffness, exponent=exponent)
    base, _, _ = cartilage.force_at(layer_depth, 0.0)
    return ContactLaw((cartilage, Layer(layer_depth, base, stiffness_2, exponent)))


def two_layer_viscoelastic(
    *,
    stiffness: float,
    exponent: float,
    damping: float,
    layer_depth: float,
    stiffness_2: float,
    damp_first_layer: bool,
) -> ContactLaw:
    """Return cartilage on bone with a dashpot of `damping` C [N s/m] in the second layer (Eq. 12), or in both.

    Eq. 12 as printed damps the second layer only: the force jumps by C δ̇ at h, and above it the knee rings.
    `damp_first_layer` adds the same dashpot to the first layer.
    """
    elastic = two_layer_elastic(
        stiffness=stiffness, exponent=exponent, layer_depth=layer_depth, stiffness_2=stiffness_2
    )
    cartilage, bone = elastic.layers
    first = damping if damp_first_layer else 0.0
    return ContactLaw((cartilage._replace(damping=first), bone._replace(damping=damping)))


def _impact_damped(
    stiffness: float, exponent: float, loss: float, least_impact_speed: float
) -> ContactLaw:
    """Return a law whose damping remembers the impact: F = K δⁿ (1 + D δ̇ / max(v₀, v_least)).

    The laws that use it differ only in the loss number D(e), where e is the wanted coefficient of restitution. The
    restitution of a free impact depends on D alone: it is the root e' of (1 + e') D = ln((1 + D) / (1 - e' D)).
    `least_impact_speed` [m/s] is a floor under v₀, and the v₀ of contacts that did not begin with an impact. Without it
    D/v₀ would grow without bound for soft touches, and make the knee almost rigid.
    """
    layer = Layer(
        stiffness=stiffness, exponent=exponent, loss=loss, least_impact_speed=least_impact_speed
    )
    return ContactLaw((layer,))


def hunt_crossley(
    *, stiffness: float, exponent: float, restitution: float, least_impact_speed: float
) -> ContactLaw:
    """Return the law with D = 1.5 (1 - e), for small losses; see `_impact_damped` for the other arguments.

    Source: Hunt & Crossley 1975, doi:10.1115/1.3423596, with their e = 1 - α v₀ and D = 1.5 α v₀. Impacts deliver e
    within 0.01 for e >= 0.9, but 0.663 for e = 0.5, and never less than 0.487.
    """
    return _impact_damped(stiffness, exponent, 1.5 * (1.0 - restitution), least_impact_speed)


def lankarani_nikravesh(
    *, stiffness: float, exponent: float, restitution: float, least_impact_speed: float
) -> ContactLaw:
    """Return the law with D = 0.75 (1 - e²), for small losses; see `_impact_damped` for the other arguments.

    Source: Lankarani & Nikravesh 1990, doi:10.1115/1.2912617. Impacts deliver e within 0.01 for e >= 0.92, but 0.725
    for e = 0.5, and never less than 0.663.
    """
    return _impact_damped(stiffness, exponent, 0.75 * (1.0 - restitution**2), least_impact_speed)


def flores(
    *, stiffness: float, exponent: float, restitution: float, least_impact_speed: float
) -> ContactLaw:
    """Return the law with D = 8 (1 - e) / (5 e), for soft materials; see `_impact_damped` for the other arguments.

    Source: Flores, Machado, Silva & Martins 2011, doi:10.1007/s11044-010-9237-4. Impacts deliver e within 0.05 (0.470
    for e = 0.5), within 0.01 for e >= 0.83. `gonthier` is the better one for e below 0.6.
    """
    loss = 8.0 * (1.0 - restitution) / (5.0 * restitution)
    return _impact_damped(stiffness, exponent, loss, least_impact_speed)


def gonthier(
    *, stiffness: float, exponent: float, restitution: float, least_impact_speed: float
) -> ContactLaw:
    """Return the law with D = (1 - e²) / e, for large losses; see `_impact_damped` for the other arguments.

    Source: Gonthier, McPhee, Lange & Piedbœuf 2004, doi:10.1023/B:MUBO.0000029392.21648.bc. Impacts deliver e within
    0.033 (0.488 for e = 0.5), exactly e where e nears 0, and a third too little loss where e nears 1.
    """
    loss = (1.0 - restitution**2) / restitution
    return _impact_damped(stiffness, exponent, loss, least_impact_speed)


def elastic_foundation(
    *,
    youngs_modulus: float,
    poissons_ratio: float,
    foundation_thickness: float,
    femoral_radius: float,
    tibial_radius: float,
) -> ContactLaw:
    """Return a bed of independent springs on rigid bone, pressed by a sphere: F = π (M/t) R δ² (Winkler).

    M = E (1 - ν) / ((1 + ν) (1 - 2ν)) is the modulus of a layer that is bonded to bone and cannot spread sideways: E is
    `youngs_modulus` [Pa] and ν `poissons_ratio` (below 0.5) of the cartilage. t is `foundation_thickness` [m], femoral
    and tibial cartilage together; R is `relative_radius` of `femoral_radius` and `tibial_radius` [m].

    Source: Johnson 1985, Contact Mechanics, Sec. 4.3; for the knee Blankevoort et al. 1991,
    doi:10.1016/0021-9290(91)90019-J. Valid for δ << t, a contact radius √(2 R δ) that is large compared with t,
    and a compressible layer. The law has no damping.

    Raises:
        ValueError: see `relative_radius`.
    """
    bulging = (1.0 + poissons_ratio) * (1.0 - 2.0 * poissons_ratio)
    modulus = youngs_modulus * (1.0 - poissons_ratio) / bulging
    radius = relative_radius(femoral_radius, tibial_radius)
    stiffness = math.pi * modulus / foundation_thickness * radius
    return ContactLaw((Layer(stiffness=stiffness, exponent=2.0),), foundation_thickness)


CONTACT_LAWS: dict[str, Callable[..., ContactLaw]] = {
    law.__name__: law
    for law in (
        hertz,
        kelvin_voigt,
        two_layer_elastic,
        two_layer_viscoelastic,
        hunt_crossley,
        lankarani_nikravesh,
        flores,
        gonthier,
        elastic_foundation,
    )
}
"""Contact laws by the names that the parameter `contact.law` uses"""


def relative_radius(femoral_radius: float, tibial_radius: float) -> float:
    """Return the relative radius R [m] of a convex femur on a concave tibia: 1/R = 1/r_F - 1/r_T.

    A sphere of radius R on a plane has the same gap near the contact. Both radii [m] are > 0; a tibial radius of
    infinity is a flat plateau.

    Raises:
        ValueError: the tibial radius does not exceed the femoral one, so that the femur does not fit into the tibia.
    """
    if not 0.0 < femoral_radius < tibial_radius:
        raise ValueError(
            f"0 < femoral radius < tibial radius (concave) is needed, got {femoral_radius:g} m and {tibial_radius:g} m"
        )
    return 1.0 / (1.0 / femoral_radius - 1.0 / tibial_radius)


def hertz_stiffness(youngs_modulus: float, poissons_ratio: float, relative_radius: float) -> float:
    """Return the stiffness K [N/m^1.5] of Hertz' law: K = 4/3 E* √R, E* = E / (2 (1 - ν²)) for bodies of one material.

    `youngs_modulus` is E [Pa], `poissons_ratio` ν (0 to 0.5), `relative_radius` R [m]. Source: Hertz 1882; Johnson
    1985, Contact Mechanics, Eq. 4.23. Valid for solids much thicker than the contact radius √(R δ).

    The paper's bone (17.2 GPa, 0.39, radii 34 and 95 mm) gives its second layer: 3.112e9 N/m^1.5 = 98 408 N/mm^1.5. Its
    cartilage (24 MPa, 0.38) gives 4.30e6 N/m^1.5 = 136 N/mm^1.5, and not the 2500 of Table 1, which are calibrated:
    cartilage is a thin layer on bone, hence stiffer than the half-space of this formula.
    """
    plane_modulus = youngs_modulus / (2.0 * (1.0 - poissons_ratio**2))
    return 4.0 / 3.0 * plane_modulus * math.sqrt(relative_radius)


_CHECKED_DEPTHS = (1e-7, 1e-5, 1e-4, 1e-3)
"""Depths [m] beyond the beginning of a layer at which a law's own formula is checked"""


def check(law: ContactLaw) -> None:
    """Check the layers whose formula is not the common one, and the order of all layers.

    Raises:
        ValueError: one line that says which layer does not fulfil what `ContactLaw` requires, and where.
    """
    begins = [layer.begin for layer in law.layers]
    if not begins or begins[0] != 0.0 or any(not b > a for a, b in pairwise(begins)):
        raise ValueError(
            f"contact law: the first layer must begin at 0 m and each next one deeper, got {begins}"
        )
    before = 0.0
    for number, layer in enumerate(law.layers, start=1):
        begins_with = layer.force_at(layer.begin, 0.0)[0]
        if layer.form != COMMON:
            if abs(begins_with - before) > 1e-9 * max(1.0, abs(before)):
                raise ValueError(
                    f"contact law: layer {number} does not begin with the force at which the layer before ends"
                )
            for beyond in _CHECKED_DEPTHS:
                _check_slopes(layer, number, beyond)
        if number < len(law.layers):
            before = layer.force_at(law.layers[number].begin, 0.0)[0]


def _check_slopes(layer: Layer, number: int, beyond: float) -> None:
    """Check the formula of a law's layer at a depth [m] beyond its beginning: slopes, and linear in the rate.

    Raises:
        ValueError: as `check`.
    """
    depth = layer.begin + beyond
    step = 1e-5 * beyond
    force, stiffness, damping = layer.force_at(depth, 0.0)
    moving = layer.force_at(depth, 0.1)[0]
    ahead = layer.force_at(depth + step, 0.0)[0]
    behind = layer.force_at(depth - step, 0.0)[0]
    slope = (ahead - behind) / (2.0 * step)
    true = abs(slope - stiffness) <= 1e-3 * (abs(stiffness) + abs(slope))
    linear = abs(moving - force - 0.1 * damping) <= 1e-6 * (abs(force) + abs(moving))
    if not (true and linear and math.isfinite(moving) and stiffness >= 0.0 and damping >= 0.0):
        raise ValueError(
            f"contact law: layer {number} is not finite, has wrong or negative slopes ({stiffness:g} N/m where "
            f"the force has {slope:g}, {damping:g} N s/m), or is not linear in the rate, at {depth:g} m"
        )
