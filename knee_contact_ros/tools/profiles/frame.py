"""Where the origin of a profile lies."""

from __future__ import annotations

import numpy as np

from knee_contact_ros.core.arrays import Floats
from knee_contact_ros.system.errors import UsageError
from knee_contact_ros.tools.profiles.fit import Fit

MESH, SURFACE = "mesh", "surface"


def origin_of(fit: Fit, text: str | None) -> Floats:
    """The profile's origin in the mesh's axes [m], shape (2,).

    `mesh` is the mesh's own (default of a femur), `surface` the tibia's surface at the mesh's x = 0 (default of a
    tibia), `X,Y` a point in mm.

    Raises:
        UsageError: none of these, or the tibia does not reach to x = 0.
    """
    text = text or (MESH if fit.femur else SURFACE)
    if text == MESH:
        return np.zeros(2)
    if text == SURFACE and not fit.femur:
        x, y = fit.shape.points.T
        if not x.min() <= 0.0 <= x.max():
            raise UsageError(
                f"--origin surface: the plateau reaches from x = {1e3 * x.min():.1f} to {1e3 * x.max():.1f} mm, "
                "not over x = 0; give --origin X,Y in mm"
            )
        return np.array([0.0, float(np.interp(0.0, x, y))])
    try:
        place = np.array([float(number) * 1e-3 for number in text.split(",")])
    except ValueError:
        place = np.empty(0)
    if place.shape != (2,) or not np.isfinite(place).all():
        allowed = "mesh or X,Y in mm" if fit.femur else "surface, mesh or X,Y in mm"
        raise UsageError(f"--origin {text}: it must be {allowed}")
    return place
