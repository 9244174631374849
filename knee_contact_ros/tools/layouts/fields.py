"""Fields of messages that are plotted in viewers that know nothing of a knee, in SI units.

`rerun_direct.py`, `foxglove.py` and `plotjuggler.py` write them in each viewer's format.
"""

from __future__ import annotations

import re
from typing import NamedTuple

from knee_contact_ros.model.types import ContactState, Fidelity, Status
from knee_contact_ros.streams.topics import JOINT_REACTION_FORCE, KNEE_CONTACT, KNEE_CONTACT_WRENCH
from knee_contact_ros.system.errors import UsageError


class Colour(NamedTuple):
    """Colour: red, green and blue from 0 to 255, and its name."""

    red: int
    green: int
    blue: int
    name: str

    @property
    def rgb(self) -> tuple[int, int, int]:
        """Red, green and blue."""
        return self.red, self.green, self.blue

    @property
    def code(self) -> str:
        """Colour as `#rrggbb`."""
        return f"#{self.red:02x}{self.green:02x}{self.blue:02x}"


BLUE = Colour(110, 170, 235, "blue")
RED = Colour(235, 95, 80, "red")
GREY = Colour(140, 150, 175, "grey")
YELLOW = Colour(250, 200, 70, "yellow")
GREEN = Colour(110, 200, 130, "green")
BONE = Colour(205, 175, 120, "sand")
VIOLET = Colour(190, 140, 230, "violet")


class Curve(NamedTuple):
    """Number in a message that is plotted over time."""

    topic: str
    """Relative name of the topic, as in `topics.py`"""
    field: str
    """Name of the field with dots: `contact_point.x`"""
    name: str
    """Name of the curve"""
    colour: Colour
    width: float = 1.5
    """Width of the line [pixels]"""


class Plot(NamedTuple):
    """Plot of curves with a common axis."""

    title: str
    unit: str
    """Unit of all curves; empty for a count"""
    curves: tuple[Curve, ...]

    def with_unit(self, name: str) -> str:
        """Text of a name with the unit: `load [N]`."""
        return f"{name} [{self.unit}]" if self.unit else name

    @property
    def headline(self) -> str:
        """Title with unit, names and colours of the curves, as a legend would lie over the curves."""
        if len(self.curves) == 1:
            return self.with_unit(self.title)
        names = ", ".join(f"{curve.name} {curve.colour.name}" for curve in self.curves)
        return self.with_unit(f"{self.title}: {names}")


class Lane(NamedTuple):
    """Lane of a number that stands for a state."""

    field: str
    """Name of the field of the topic `knee_contact`"""
    title: str
    words: dict[int, str]
    """Name of the state for each number"""
    colours: dict[int, Colour]
    """Colour of the state for each number"""


PLOTS = (
    Plot("Flexion angle", "rad", (Curve(KNEE_CONTACT, "flexion_angle", "flexion angle", BLUE, 2.0),)),
    Plot(
        "Force",
        "N",
        (
            Curve(KNEE_CONTACT, "load", "load", GREY, 4.0),
            Curve(KNEE_CONTACT, "contact_force", "contact force", RED),
        ),
    ),
    Plot(
        "Depth",
        "m",
        (
            Curve(KNEE_CONTACT, "penetration_depth", "penetration", BLUE, 2.0),
            Curve(KNEE_CONTACT, "bone_depth", "in the second layer", BONE),
            Curve(KNEE_CONTACT, "gap", "gap", GREY),
        ),
    ),
    Plot(
        "Contact point",
        "m",
        (
            Curve(KNEE_CONTACT, "contact_point.x", "anterior", YELLOW, 3.0),
            Curve(KNEE_CONTACT, "contact_point.y", "superior", GREEN),
        ),
    ),
    Plot("Sliding velocity", "m/s", (Curve(KNEE_CONTACT, "sliding_velocity", "sliding velocity", GREEN),)),
    Plot("Evaluations per tick", "", (Curve(KNEE_CONTACT, "evaluations", "evaluations", VIOLET),)),
    Plot("Error of the depth", "m", (Curve(KNEE_CONTACT, "error_estimate", "error estimate", YELLOW),)),
    Plot("Error of the force", "N", (Curve(KNEE_CONTACT, "force_error_estimate", "force error estimate", RED),)),
    Plot(
        "Joint reaction",
        "N",
        (
            Curve(JOINT_REACTION_FORCE, "wrench.force.x", "anterior", BLUE),
            Curve(JOINT_REACTION_FORCE, "wrench.force.y", "superior", RED, 2.0),
            Curve(JOINT_REACTION_FORCE, "wrench.force.z", "right", GREY),
        ),
    ),
    Plot(
        "Force on the tibia",
        "N",
        (
            Curve(KNEE_CONTACT_WRENCH, "wrench.force.x", "anterior", BLUE),
            Curve(KNEE_CONTACT_WRENCH, "wrench.force.y", "superior", RED, 2.0),
        ),
    ),
)
ON_THE_KNEE = 5
"""Number of the first plots that show what the knee does; the others show how that was computed"""
JOINTS = "Joint positions [rad]"
"""Title of the plot of `joint_states`, whose curves are named after the joints"""
STATES = "Contact, level of the model, status"
"""Title of the lanes"""


def _status_words() -> dict[int, str]:
    """Names of the states of every combination of status bits."""
    bits = [bit for bit in Status if bit]
    words = {
        value: " + ".join(str(bit.name).lower().replace("_", " ") for bit in bits if value & bit)
        for value in range(1 << len(bits))
    }
    return words | {0: "ok"}


STATUS = _status_words()
LANES = (
    Lane(
        "contact_state",
        "contact",
        {state: state.name.lower() for state in ContactState},
        {ContactState.SEPARATED: GREY, ContactState.CARTILAGE: BLUE, ContactState.BONE: BONE},
    ),
    Lane(
        "fidelity",
        "level",
        {level: level.name.lower().replace("_", " ") for level in Fidelity},
        {Fidelity.QUASI_STATIC: GREY, Fidelity.FIRST_ORDER: YELLOW, Fidelity.DYNAMIC: VIOLET},
    ),
    Lane("status", "status", STATUS, {value: RED if value else GREEN for value in STATUS}),
)


def checked(namespace: str) -> str:
    """Check a namespace and return it.

    Raises:
        UsageError: it is no valid name of a ROS namespace.
    """
    if namespace and not re.fullmatch(r"/?[A-Za-z_]\w*(/[A-Za-z_]\w*)*/?", namespace, re.ASCII):
        raise UsageError(f"--namespace {namespace!r}: it must be a name, as left or robot/left")
    return namespace
