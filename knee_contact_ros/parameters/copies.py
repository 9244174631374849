"""Makes models copyable and picklable: registers the named tuples whose `__new__` does not take their fields.

Registered here and not as `__reduce__` in the core: a changed source there makes compiled kernels invalid.
"""

from __future__ import annotations

import copyreg
from collections.abc import Callable
from typing import Any

from knee_contact_ros.core.contact_pairs.on_curve import CurveContact
from knee_contact_ros.core.contact_pairs.on_plane import OnPlane
from knee_contact_ros.core.contact_pairs.tibial_circle import TibialCircle
from knee_contact_ros.core.contact_pairs.tibial_profile import TibialProfile
from knee_contact_ros.core.geometries import Profile
from knee_contact_ros.core.mechanisms import Table

MADE_OF_OTHERS = (CurveContact, OnPlane, Profile, Table, TibialCircle, TibialProfile)
"""Classes of named tuples with a `__new__` of their own"""


def _as_it_is(part: tuple[Any, ...]) -> tuple[Callable[..., Any], tuple[Any, ...]]:
    """Reduce a part for `pickle` and `copy` to its fields, so that they are not computed again."""
    return tuple.__new__, (type(part), tuple(part))


for _kind in MADE_OF_OTHERS:
    copyreg.pickle(_kind, _as_it_is)
