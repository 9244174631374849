"""Subject file: a short YAML file with the properties of a person's knee, and the gait to compute."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from pydantic import Field, ValidationError

from knee_contact_ros.joint_reaction.leg import GRAVITY
from knee_contact_ros.parameters.declared import first_error
from knee_contact_ros.parameters.reading import load_parameters
from knee_contact_ros.parameters.sections import Section
from knee_contact_ros.system.errors import UsageError
from knee_contact_ros.system.resources import DEFAULT_PARAMETERS, expanded, find_file
from knee_contact_ros.system.yaml_file import read_mapping

FEMORAL_SHARE = 9.3014 / 75.16
"""Ratio of the masses of the femur's segment and the body in OpenSim's model gait2354, which scales both alike"""


class SubjectFile(Section):
    """Content of a subject file."""

    name: str = Field("", description="of the person; for the reader")
    mass: float = Field(ge=1.0, le=500.0, description="[kg] of the body")
    parameters: list[str] = Field([DEFAULT_PARAMETERS], min_length=1, description="parameter files, the later one wins")
    profile: str = Field("", description="femoral profile: CSV of x, y [m]")
    tibial_profile: str = Field("", description="CSV of x, y [m]")
    scale: float = Field(1.0, ge=0.2, le=5.0, description="size of this knee over that of the surfaces given")
    thickness: float | None = Field(None, gt=0.0, le=0.1, description="[m] of cartilage at which bone begins")
    joint: str = Field("", description="in joint_states")
    bag: str = Field("", description="gait bag")


class Subject:
    """Subject of a subject file; files that it names lie beside it, or among the package's own."""

    def __init__(self, path: Path) -> None:
        """Read a subject file.

        Raises:
            UsageError: it cannot be read, or has an entry that is not allowed.
        """
        self.path = path
        mapping = read_mapping(path, "subject file", "names to values")
        try:
            self.content = SubjectFile.model_validate(dict(mapping))
        except ValidationError as error:
            raise UsageError(f"subject file {path}: {first_error(error)}") from None

    @property
    def bag(self) -> Path | None:
        """Gait bag that the file names; None if it names none."""
        return self._file(self.content.bag) if self.content.bag else None

    def sources(self) -> list[Path | Mapping[str, Any]]:
        """Sources for `load_parameters`: the parameter files of the subject, and the subject's own values, which win.

        Raises:
            UsageError: one of the parameter files cannot be used.
        """
        files: list[Path | Mapping[str, Any]] = [self._file(name) for name in self.content.parameters]
        before = load_parameters(files)
        values: dict[str, Any] = {
            "body_weight": self.content.mass * GRAVITY,
            "femur.mass": self.content.mass * FEMORAL_SHARE,
        }
        if self.content.thickness is not None:
            values["contact.layer_depth"] = self.content.thickness
        if self.content.joint:
            values["knee.joint_name"] = self.content.joint
        values |= self._surface("femur", self.content.profile, before.femur.geometry, before.femur.radius)
        values |= self._surface("tibia", self.content.tibial_profile, before.tibia.geometry, before.tibia.radius)
        return [*files, values]

    def _surface(self, bone: str, profile: str, geometry: str, radius: float) -> dict[str, Any]:
        """Parameters of a bone's surface, to scale: the subject's profile, or the surface of the parameter files."""
        scale = self.content.scale
        if profile:
            return {
                f"{bone}.geometry": "profile", f"{bone}.profile": str(self._file(profile)), f"{bone}.scale": scale
            }  # fmt: skip
        if geometry == "profile":
            return {f"{bone}.scale": scale}
        return {f"{bone}.radius": radius * scale} if geometry == "circle" else {}

    def _file(self, name: str) -> Path:
        path = expanded(name)
        beside = self.path.parent / path
        return path if path.is_absolute() else beside if beside.exists() else find_file(name)
