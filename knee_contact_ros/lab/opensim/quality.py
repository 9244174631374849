"""Judge a run of OpenSim's tools by its residuals, reserves and marker errors.

The limits are from the literature (Hicks, Uchida, Seth, Rajagopal, Delp: Is my model good enough? J Biomech Eng 137(2),
020905, 2015, doi:10.1115/1.4029304): residual forces below 5 % of the peak net external force, residual moments below
1 % of that force times the height of the centre of mass, reserves below 5 % of the peak net joint moment. Markers:
errors below 2 cm RMS and 4 cm at most, as in OpenSim's best practices. A reserve below 1 N m always passes (our own
choice): unloaded joints, such as a foot's in swing, have no net moment to compare with.
"""

from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from ...model.types import Floats, Stamps
from ...system.errors import UsageError
from ..tables import Table, read_storage
from .run import OpenSimRun
from .setups import (
    EXTERNAL_LOADS,
    IK,
    Setup,
    data_file,
    read_xml,
    text_in,
)

_SMALL_RESERVE = 1.0
"""Reserve that always passes [N m]"""
_MARKER_ERRORS = {
    "marker error, RMS of all": ("marker_error_RMS", 20.0),
    "marker error, the worst": ("marker_error_max", 40.0),
}
"""Columns of marker errors, and the largest ones [mm]"""
_PELVIS = "pelvis"
"""Beginning of the names of coordinates whose actuators are residuals"""

DO_NOT_TRUST = "Do not trust"
"""Beginning of the verdict on values above their limits"""


class Check(NamedTuple):
    """Quantity of a run and its limit."""

    name: str
    peak: float
    rms: float
    allowed: float
    """Limit of the peak"""
    unit: str
    basis: str
    """Origin of the limit, as text"""

    @property
    def passed(self) -> bool:
        """Whether the peak is within the limit."""
        return self.peak <= self.allowed

    def sentence(self) -> str:
        """Describe the quantity, its limit and the verdict in a line."""
        verdict = "within" if self.passed else "ABOVE"
        numbers = f"peak {self.peak:.3g}, RMS {self.rms:.3g} {self.unit}"
        return f"{self.name}: {numbers}, {verdict} {self.allowed:.3g} ({self.basis})"


def assess(run: OpenSimRun) -> list[Check]:
    """Check residuals, markers and reserves of a run; lists only reserves of the knee or above their limit.

    Raises:
        UsageError: a file of the run cannot be read.
    """
    forces = read_storage(run.forces)
    residual_forces, residual_moments, reserves = _actuators_of(run.muscles, run.folder, forces)
    loads = run.folder / run.muscles.text(EXTERNAL_LOADS)
    external = _external_peak(loads, run.folder, forces.stamps)
    centre = read_storage(run.result("BodyKinematics_pos_global"))
    height = float(centre.column("center_of_mass_Y").mean())
    found = []
    if residual_forces:
        values = np.linalg.norm([forces.column(name) for name in residual_forces], axis=0)
        basis = f"5 % of {external:.0f} N of external force"
        allowed = 0.05 * external
        found.append(_check("residual force", values, allowed, "N", basis))
    if residual_moments:
        values = np.linalg.norm([forces.column(name) for name in residual_moments], axis=0)
        basis = f"1 % of {external:.0f} N x {height:.2f} m"
        allowed = 0.01 * external * height
        found.append(_check("residual moment", values, allowed, "N m", basis))
    moments = read_storage(run.moments)
    for name, coordinate in reserves.items():
        if f"{coordinate}_moment" not in moments.names:
            continue
        peak = float(np.abs(moments.column(f"{coordinate}_moment")).max())
        basis = f"5 % of the net {peak:.3g} N m, at least {_SMALL_RESERVE:g}"
        allowed = max(0.05 * peak, _SMALL_RESERVE)
        check = _check(f"reserve {coordinate}", forces.column(name), allowed, "N m", basis)
        # Those of the knee are shown even if they are small.
        if "knee" in coordinate or not check.passed:
            found.append(check)
    for setup in run.setups:
        path = setup.folder / setup.results / f"{setup.name}_ik_marker_errors.sto"
        if setup.step == IK and path.is_file():
            errors = read_storage(path)
            for name, (column, allowed) in _MARKER_ERRORS.items():
                values = errors.column(column) * 1e3
                found.append(_check(name, values, allowed, "mm", "best practices"))
    return found


def _check(name: str, values: Floats, allowed: float, unit: str, basis: str) -> Check:
    peak = float(np.abs(values).max())
    return Check(name, peak, float(np.sqrt(np.mean(values**2))), allowed, unit, basis)


def verdict(found: Sequence[Check]) -> list[str]:
    """Return lines with residuals, reserves and marker errors, their limits, and a conclusion."""
    above = ", ".join(check.name for check in found if not check.passed)
    text = "Residuals, reserves and markers are within the limits in the literature (doi:10.1115/1.4029304)."
    if above:
        text = (
            f"{DO_NOT_TRUST} these results before you know why these values exceed the limits in the literature "
            f"(doi:10.1115/1.4029304): {above}."
        )
    return [*(f"- {check.sentence()}" for check in found), text]


def _actuators_of(
    muscles: Setup, folder: Path, forces: Table
) -> tuple[list[str], list[str], dict[str, str]]:
    """Return the names of residual forces and moments, and coordinates of reserves by name, in the force set files.

    Raises:
        UsageError: a file cannot be read.
    """
    residual_forces, residual_moments, reserves = [], [], {}
    for file in muscles.text("force_set_files").split():
        for element in read_xml(folder / file).findall(".//objects/*"):
            name, coordinate = element.get("name", ""), text_in(element, "coordinate")
            if name not in forces.names:
                continue
            if element.tag == "PointActuator" or (
                coordinate.startswith(_PELVIS) and coordinate[-3:-1] == "_t"
            ):
                residual_forces.append(name)
            elif element.tag == "TorqueActuator" or coordinate.startswith(_PELVIS):
                residual_moments.append(name)
            elif coordinate:
                reserves[name] = coordinate
    return residual_forces, residual_moments, reserves


def _external_peak(loads: Path, folder: Path, stamps: Stamps) -> float:
    """Return the largest net external force [N] between the first and the last stamp.

    Raises:
        UsageError: the loads cannot be read.
    """
    data = read_storage(data_file(loads, folder))
    names = [
        text_in(force, "force_identifier")
        for force in read_xml(loads, "ExternalLoads").iter("ExternalForce")
    ]
    names = [name for name in names if f"{name}x" in data.names]
    if not names:
        raise UsageError(f"{loads}: no force_identifier of it is in {data.path}")
    net = sum(np.column_stack([data.column(f"{name}{axis}") for axis in "xyz"]) for name in names)
    inside = (data.stamps >= stamps[0]) & (data.stamps <= stamps[-1])
    return float(np.linalg.norm(net, axis=1)[inside].max())
