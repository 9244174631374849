"""Readouts of a contact besides its depth: patch, pressure, strain of the cartilage and loading rate.

They do not affect the answers. They follow from the depth and force of an answer, the contact law at rest, and two
numbers from the constants of the law, `ContactPatch.radius` and `ContactPatch.thickness`.

A law gives a force but no pressure. The pressure is that force, spread over a round patch by one of two closed forms
(`Spread`). Each is exact for one law; the force of any other law is spread as Hertz's:

    a² = s R δ,    p_mean = F₀(δ) / (π a²),    p_peak = k p_mean

    POINT_CONTACT  s = 1, k = 3/2   Hertz, two curved solids: exact for F₀ = K δ^1.5, with 3 K / (4 √R) the modulus E*
    FOUNDATION     s = 2, k = 2     a bed of springs on bone: exact for `elastic_foundation`, p(r) = M u(r) / t

F₀ is the law at rest. A dashpot's force is left out: it has no distribution of its own, and would be infinitely dense
at first touch. Sources: Hertz 1882, doi:10.1515/crll.1882.92.156; Johnson 1985, Contact Mechanics, Secs. 3.4, 4.2 and
4.3. Both are valid where a is small compared with R. Hertz' form also needs a to be small compared with the cartilage's
thickness; otherwise the truth lies between the two forms (docs/decisions/compartments.md). A line contact is not
offered: it needs a width, which a planar model lacks, and its force is not a power of the depth.
"""

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from .laws import ContactLaw
from .statics import plain_static_depth
from .types import NANOSECOND, ContactState, Rows, Status

Readings = NDArray[Any]
"""Readouts of answers: an array of `READOUTS`, shape (n,)"""
READOUTS = np.dtype(
    [
        ("half_width", "f8"),  # [m] of the patch, which is round
        ("mean_pressure", "f8"),  # [Pa]
        ("peak_pressure", "f8"),  # [Pa] in the middle of the patch
        ("strain", "f8"),  # nominal, of the cartilage
        ("loading_rate", "f8"),  # [N/s] of the contact force since the tick before
    ]
)
READOUTS_OF_LAW = ("half_width", "mean_pressure", "peak_pressure", "strain")
"""Names of the readouts that depend on the contact law"""


class Spread(NamedTuple):
    """Distribution of a force over a contact patch."""

    name: str
    """Name of the distribution, for messages"""
    area: float
    """Factor s of the patch's half width a: a² = s R δ"""
    peak: float
    """Factor k: the peak pressure over the mean one"""


POINT_CONTACT = Spread("Hertz, point contact", 1.0, 1.5)
"""Spread of two curved solids"""
FOUNDATION = Spread("elastic foundation", 2.0, 2.0)
"""Spread of a bed of springs"""
SPREADS = {"elastic_foundation": FOUNDATION}
"""Distributions of laws whose force is not spread as Hertz's, by the law's name"""
LAWS_WITH_PRESSURE = ("hertz", "elastic_foundation")
"""Laws for which the pressure is exact; for others it is the static force in a Hertzian distribution"""


class ContactPatch(NamedTuple):
    """The patch that the contacts of a model spread over.

    Example:
        >>> from knee_contact_ros import load_model
        >>> print(f"{1e3 * load_model().patch.radius:.1f} mm")
        53.0 mm
    """

    spread: Spread
    radius: float
    """R [m]: radius of a sphere on a plane with the same gap as femur and tibia (`relative_radius`)"""
    thickness: float
    """Thickness of the cartilage [m]; its nominal strain is the depth in it over this"""

    def readouts(self, law: ContactLaw, rows: Rows) -> Readings:
        """Compute the readouts of answers of a law, given in their order in time; shape (n,).

        When apart, and at depth 0, all but the loading rate are 0. The loading rate [N/s] is (F - F before) / (t - t
        before) of the contact force, damping included: NaN at the first answer, and where stamps went back. The strain
        is that of the first layer: in contact with the second one it is 1 if the depth of the first layer is the
        thickness.
        """
        read = np.zeros(len(rows), dtype=READOUTS)
        depth = np.ascontiguousarray(rows["penetration_depth"])
        force = np.array([law.static_force(one) for one in depth.tolist()])
        area = math.pi * self.spread.area * self.radius * depth
        touching = (rows["contact_state"] != ContactState.SEPARATED) & (area > 0.0)
        read["half_width"] = np.where(touching, np.sqrt(np.maximum(area, 0.0) / math.pi), 0.0)
        read["mean_pressure"] = np.divide(force, area, out=np.zeros_like(area), where=touching)
        read["peak_pressure"] = self.spread.peak * read["mean_pressure"]
        read["strain"] = rows["cartilage_depth"] / self.thickness
        read["loading_rate"] = np.nan
        steps = np.diff(rows["stamp"]) * NANOSECOND
        continues = (steps > 0.0) & ((rows["status"][1:] & Status.TIME_RESET) == 0)
        change = np.diff(rows["contact_force"])
        np.divide(change, steps, out=read["loading_rate"][1:], where=continues)
        return read.view(np.recarray)


_UNCERTAINTY = np.dtype([("contact_force", "f8"), ("penetration_depth", "f8")])
"""Standard deviations [N] and [m]"""


def load_uncertainty(law: ContactLaw, rows: Rows, load_deviation: Any) -> Readings:
    """Propagate the standard deviation of the load to contact force and depth, to first order, shape (n,).

    For a contact at rest, the force's deviation is the load's times the ratio of force to load, and the depth's is that
    over the stiffness of the law at rest. Under small forces this is too much; then the depth that the deviation alone
    would cause is used, which is an upper bound. Inertia and damping are left out. See `KneeModel.uncertainty`.
    """
    deviation = np.broadcast_to(np.asarray(load_deviation, dtype=np.float64), len(rows))
    if (deviation < 0.0).any():
        raise ValueError(f"load_deviation must not be negative, got {deviation.min()}")
    found = np.zeros(len(rows), dtype=_UNCERTAINTY)
    pressed = (rows["load"] > 0.0) & (rows["contact_force"] > 0.0)
    ratio = np.divide(rows["contact_force"], rows["load"], out=np.ones(len(rows)), where=pressed)
    force = found["contact_force"] = deviation * np.where(pressed, ratio, 1.0)
    depths = rows["penetration_depth"].tolist()
    stiffness = np.array([law.force_at(depth, 0.0)[1] for depth in depths])
    depth = np.divide(force, stiffness, out=np.full(len(rows), np.inf), where=stiffness > 0.0)
    # Laws harden: only under a force below its deviation is the depth of the deviation alone the smaller bound.
    for place in np.flatnonzero(rows["contact_force"] < force).tolist():
        depth[place] = min(depth[place], plain_static_depth(law.rows, float(force[place])))
    found["penetration_depth"] = np.where(np.isnan(force), np.nan, depth)
    return found.view(np.recarray)
