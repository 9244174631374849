"""The moment arms of `joint_reaction/muscles.py`, fitted again to an OpenSim model with the muscles of gait2354.

python -m studies.moment_arms MODEL.osim
"""

from __future__ import annotations

from importlib.util import find_spec
from pathlib import Path
from typing import Any, NamedTuple

import click
import numpy as np
from numpy.typing import NDArray
from tabulate import tabulate

from knee_contact_ros.joint_reaction import muscles as moment_arms

Floats = NDArray[np.float64]
KNEE, ANKLE = "knee_angle_r", "ankle_angle_r"
CALF = ("med_gas_r", "soleus_r")
PLANTARFLEXORS = (*CALF, "tib_post_r")
MM, STEP = 1e3, 2.5


class Group(NamedTuple):
    """Muscles whose moment arms are averaged, weighted by their maximum isometric forces."""

    name: str
    muscles: tuple[str, ...]
    coordinate: str
    sign: float
    """Sign of the coordinate relative to the angle that the polynomial takes"""
    span: tuple[float, float]
    """Range [deg] of that angle"""
    shipped: tuple[float, ...]
    positive: float
    """Sign of the model's moment arm for the action of the group"""


FLEXION, DORSIFLEXION = (-10.0, 110.0), (-30.0, 25.0)
GROUPS = (
    Group(
        "quadriceps",
        ("vas_int_r", "rect_fem_r"),
        KNEE,
        -1.0,
        FLEXION,
        moment_arms.QUADRICEPS_ARM,
        1.0,
    ),
    Group(
        "hamstrings",
        ("bifemlh_r", "bifemsh_r"),
        KNEE,
        -1.0,
        FLEXION,
        moment_arms.HAMSTRINGS_ARM,
        -1.0,
    ),
    Group("gastrocnemius", CALF[:1], KNEE, -1.0, FLEXION, moment_arms.GASTROCNEMIUS_ARM, -1.0),
    Group("achilles", CALF, ANKLE, 1.0, DORSIFLEXION, moment_arms.ACHILLES_ARM, -1.0),
)


class Arms:
    """Moment arms of an OpenSim model, pose by pose."""

    def __init__(self, path: Path) -> None:
        """Of an OpenSim model.

        Raises:
            click.UsageError: it lacks a muscle or a coordinate.
        """
        import opensim

        opensim.Logger.setLevelString("Off")
        self._model = opensim.Model(str(path))
        self._state = self._model.initSystem()
        muscles, coordinates = self._model.getMuscles(), self._model.getCoordinateSet()
        names = {*PLANTARFLEXORS, *(name for group in GROUPS for name in group.muscles)}
        lacking = [name for name in sorted(names) if not muscles.contains(name)]
        lacking += [name for name in (KNEE, ANKLE) if not coordinates.contains(name)]
        if lacking:
            raise click.UsageError(f"{path} has no {', '.join(lacking)}")
        self._muscles: dict[str, Any] = {name: muscles.get(name) for name in names}
        self._coordinates: dict[str, Any] = {name: coordinates.get(name) for name in (KNEE, ANKLE)}

    def strength(self, muscle: str) -> float:
        """Maximum isometric force of a muscle [N]."""
        return float(self._muscles[muscle].getMaxIsometricForce())

    def at(self, muscle: str, coordinate: str, value: float) -> float:
        """Moment arm [m] of a muscle about a coordinate with a value [rad], all others at their defaults."""
        self._coordinates[coordinate].setValue(self._state, value)
        self._model.realizePosition(self._state)
        return float(
            self._muscles[muscle].computeMomentArm(self._state, self._coordinates[coordinate])
        )

    def of(self, group: Group, angles: Floats) -> Floats:
        """Moment arms of a group [m], positive, at angles [rad], shape (n,)."""
        weights = np.array([self.strength(name) for name in group.muscles])
        rows = [
            [
                group.positive * self.at(name, group.coordinate, group.sign * angle)
                for name in group.muscles
            ]
            for angle in angles.tolist()
        ]
        self._coordinates[group.coordinate].setValue(self._state, 0.0)
        found: Floats = np.array(rows) @ weights / weights.sum()
        return found


def share(arms: Arms) -> float:
    """Part of the gastrocnemius in the moment of all plantarflexors at a right angle of the foot."""
    able = [arms.strength(name) * abs(arms.at(name, ANKLE, 0.0)) for name in PLANTARFLEXORS]
    return able[0] / sum(able)


def row(group: Group, arms: Arms) -> list[str]:
    """Row of the table: a group's polynomial beside the shipped one, and how far both are off the model."""
    degrees = np.arange(group.span[0], group.span[1] + 0.5 * STEP, STEP)
    angles = np.radians(degrees)
    truth = arms.of(group, angles)
    fit = np.polynomial.polynomial.polyfit(angles, truth, len(group.shipped) - 1)
    off = [
        f"{MM * np.sqrt(np.mean((np.polynomial.polynomial.polyval(angles, each) - truth) ** 2)):.2f} mm"
        for each in (fit, group.shipped)
    ]
    return [
        group.name,
        *(", ".join(f"{number:.5f}" for number in each) for each in (fit, group.shipped)),
        *off,
    ]


@click.command()
@click.argument("model", type=click.Path(exists=True, dir_okay=False, path_type=Path))
def main(model: Path) -> None:
    """Fit the polynomials, and print them."""
    if find_spec("opensim") is None:
        click.echo("OpenSim is not installed (pip install -e '.[opensim]'): nothing is fitted")
        return
    arms = Arms(model)
    header = (
        "muscles",
        "fitted [m], by powers of rad",
        "in the package",
        "RMS of the fit",
        "RMS of the package",
    )
    click.echo(tabulate([row(group, arms) for group in GROUPS], header, disable_numparse=True))
    click.echo(
        f"\ngastrocnemius share {share(arms):.3f}, in the package {moment_arms.GASTROCNEMIUS_SHARE}"
    )


if __name__ == "__main__":
    main()
