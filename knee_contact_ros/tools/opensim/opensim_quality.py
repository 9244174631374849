"""Judge a run of OpenSim: residuals, reserves and marker errors against the limits of the literature.

Hicks, Uchida, Seth, Rajagopal, Delp: Is my model good enough? J Biomech Eng 137(2), 020905, 2015,
doi:10.1115/1.4029304: residual forces below 5 % of the peak net external force, residual moments below 1 % of that
force times the height of the centre of mass, reserves below 5 % of the peak net joint moment. Markers: errors below
2 cm RMS and 4 cm at most, as in OpenSim's best practices. A reserve below 1 N m passes, by our own judgement: joints
that carry nothing, as a foot's in swing, have no net moment to compare with.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from knee_contact_ros.offline.gait_files.storage import Floats, Stamps, Storage, read_storage
from knee_contact_ros.system.errors import UsageError
from knee_contact_ros.tools.opensim.external_loads import named_data
from knee_contact_ros.tools.opensim.model_file import read_xml, text_in
from knee_contact_ros.tools.opensim.opensim_pipeline import Run
from knee_contact_ros.tools.opensim.opensim_setups import IK, Setup

FORCE_SHARE, MOMENT_SHARE, RESERVE_SHARE = 0.05, 0.01, 0.05
"""Largest residual forces, residual moments and reserves, as shares of the quantities above"""
SMALL_RESERVE = 1.0
"""Reserve that always passes [N m]"""
MARKER_RMS, MARKER_MAX = 0.02, 0.04
"""Largest RMS and largest single marker error [m]"""
PELVIS = "pelvis"
"""Beginning of the names of coordinates whose actuators are residuals"""
ALWAYS = "knee"
"""Part of the names of reserves that are shown also if they are small"""


class Check(NamedTuple):
    """Quantity of a run with its limit."""

    name: str
    peak: float
    rms: float
    allowed: float
    """Limit of the peak"""
    unit: str
    basis: str
    """Text on the origin of the limit"""

    @property
    def passed(self) -> bool:
        """Whether the peak is within the limit."""
        return self.peak <= self.allowed

    def sentence(self) -> str:
        """Describe the quantity, its limit and the verdict in a line."""
        verdict = "within" if self.passed else "ABOVE"
        numbers = f"peak {self.peak:.3g}, RMS {self.rms:.3g} {self.unit}"
        return f"{self.name}: {numbers}, {verdict} {self.allowed:.3g} ({self.basis})"


class Actuators(NamedTuple):
    """Actuators beside the muscles."""

    forces: tuple[str, ...]
    """Names of residual forces"""
    moments: tuple[str, ...]
    """Names of residual moments"""
    reserves: dict[str, str]
    """Coordinates of reserves, by their names"""


def assess(run: Run) -> list[Check]:
    """Check residuals, markers and reserves of a run; of the reserves those of the knee and those above their limit.

    Raises:
        UsageError: a file of the run cannot be read.
    """
    forces = read_storage(run.forces)
    actuators = read_actuators(run.muscles, run.folder, forces)
    external = external_peak(run.folder / run.muscles.text("external_loads_file"), run.folder, forces.stamps)
    height = float(read_storage(run.centre_of_mass).column("center_of_mass_Y").mean())
    allowed = FORCE_SHARE * external, MOMENT_SHARE * external * height
    bases = f"5 % of {external:.0f} N of external force", f"1 % of {external:.0f} N x {height:.2f} m"
    checks = []
    if actuators.forces:
        checks.append(check("residual force", together(forces, actuators.forces), allowed[0], "N", bases[0]))
    if actuators.moments:
        checks.append(check("residual moment", together(forces, actuators.moments), allowed[1], "N m", bases[1]))
    reserves = list(reserve_checks(forces, actuators.reserves, read_storage(run.moments)))
    checks += [c for c in reserves if not c.passed or ALWAYS in c.name]
    return checks + [c for setup in run.setups if setup.step == IK for c in marker_checks(setup)]


def check(name: str, values: Floats, allowed: float, unit: str, basis: str) -> Check:
    """Make a check of values over time, shape (n,)."""
    return Check(name, float(np.abs(values).max()), float(np.sqrt(np.mean(values**2))), allowed, unit, basis)


def together(forces: Storage, names: Sequence[str]) -> Floats:
    """Magnitude over time of the vector whose components are actuators, shape (n,)."""
    return np.asarray(np.linalg.norm([forces.column(name) for name in names], axis=0))


def reserve_checks(forces: Storage, reserves: dict[str, str], moments: Storage) -> Iterator[Check]:
    """Check each reserve against the net moment of its joint."""
    for name, coordinate in reserves.items():
        net = f"{coordinate}_moment"
        if net in moments.names:
            peak = float(np.abs(moments.column(net)).max())
            basis = f"5 % of the net {peak:.3g} N m, at least {SMALL_RESERVE:g}"
            allowed = max(RESERVE_SHARE * peak, SMALL_RESERVE)
            yield check(f"reserve {coordinate}", forces.column(name), allowed, "N m", basis)


def marker_checks(setup: Setup) -> Iterator[Check]:
    """Check the marker errors of inverse kinematics, if it wrote them."""
    path = setup.folder / setup.results() / f"{setup.name}_ik_marker_errors.sto"
    if path.is_file():
        errors = read_storage(path)
        rms, most = errors.column("marker_error_RMS") * 1e3, errors.column("marker_error_max") * 1e3
        yield check("marker error, RMS of all", rms, MARKER_RMS * 1e3, "mm", "best practices")
        yield check("marker error, the worst", most, MARKER_MAX * 1e3, "mm", "best practices")


def read_actuators(muscles: Setup, folder: Path, forces: Storage) -> Actuators:
    """Read the actuators that the force set files add to the muscles.

    Raises:
        UsageError: a file cannot be read.
    """
    residual_forces, residual_moments, reserves = [], [], {}
    for file in muscles.text("force_set_files").split():
        for element in read_xml(folder / file).findall(".//objects/*"):
            name, coordinate = element.get("name", ""), text_in(element, "coordinate")
            if name not in forces.names:
                continue
            if element.tag == "PointActuator" or (coordinate.startswith(PELVIS) and coordinate[-3:-1] == "_t"):
                residual_forces.append(name)
            elif element.tag == "TorqueActuator" or coordinate.startswith(PELVIS):
                residual_moments.append(name)
            elif coordinate:
                reserves[name] = coordinate
    return Actuators(tuple(residual_forces), tuple(residual_moments), reserves)


def external_peak(loads: Path, folder: Path, stamps: Stamps) -> float:
    """Largest net external force [N] between the first and the last stamp.

    Raises:
        UsageError: the loads cannot be read.
    """
    root = read_xml(loads, "ExternalLoads")
    data = read_storage(named_data(loads, folder))
    names = [text_in(force, "force_identifier") for force in root.iter("ExternalForce")]
    names = [name for name in names if f"{name}x" in data.names]
    if not names:
        raise UsageError(f"{loads}: no force_identifier of it is in {data.path}")
    net = sum(np.column_stack([data.column(f"{name}{axis}") for axis in "xyz"]) for name in names)
    inside = (data.stamps >= stamps[0]) & (data.stamps <= stamps[-1])
    return float(np.linalg.norm(net, axis=1)[inside].max())
