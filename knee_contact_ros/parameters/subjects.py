"""Subject files: what makes one person's knee different. They are read wherever a parameter file is."""

from pathlib import Path
from typing import Any

from pydantic import Field, ValidationError

from ..joint_reaction.leg import GRAVITY
from ..system.errors import UsageError
from ..system.files import expand_user, find_file, read_mapping
from ..system.ros_files import Sections
from .load_schema import LoadParameters
from .schema import FEMORAL_SHARE, Parameters
from .sections import Section, first_error


class SubjectFile(Section):
    """Content of a subject file: properties of a person's knee, and the gait to compute."""

    name: str = ""
    """Name of the person, for labels of reports"""
    mass: float = Field(ge=1.0, le=500.0)
    """Mass of the body [kg]"""
    parameters: list[str] = Field([], min_length=1)
    """Parameter files; a later one overrides earlier ones. Without them it is the healthy knee"""
    profile: str = ""
    """CSV file of the femoral profile, x and y [m]; empty for none"""
    tibial_profile: str = ""
    """CSV file of the tibial profile, x and y [m]; empty for none"""
    scale: float = Field(1.0, ge=0.2, le=5.0)
    """Factor by which this knee is larger than the given surfaces"""
    thickness: float | None = Field(None, gt=0.0, le=0.1)
    """Thickness of the cartilage [m], at which the bone's stiffness begins; None keeps the parameter"""
    joint: str = ""
    """Name of the knee's joint in joint_states; empty keeps the parameter"""
    bag: str = ""
    """Bag with the gait; empty for none"""


class Subject:
    """Subject of a subject file; the files that it names are in its folder, or among the package's own."""

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

    @property
    def parameter_files(self) -> list[Path]:
        """Parameter files that the file names."""
        return [self._file(name) for name in self.content.parameters]

    def sections(self, base: Parameters, given: dict[str, Any]) -> Sections:
        """Return what the subject sets for the contact node and the load node, as sections of a parameter file.

        `base` are the parameters of its parameter files, and `given` the values that these set.
        """
        content = self.content
        values: dict[str, Any] = {
            "body_weight": content.mass * GRAVITY,
            "femur.mass": content.mass * FEMORAL_SHARE,
        }
        joint = {"knee.joint_name": content.joint} if content.joint else {}
        if content.thickness is not None:
            values["contact.layer_depth"] = content.thickness
        surfaces = (
            ("femur", content.profile, base.femur),
            ("tibia", content.tibial_profile, base.tibia),
        )
        for bone, profile, surface in surfaces:
            if profile:
                values |= {
                    f"{bone}.geometry": "profile",
                    f"{bone}.profile": str(self._file(profile).absolute()),
                }
            if profile or surface.geometry == "profile":
                values[f"{bone}.scale"] = content.scale
            elif surface.geometry == "circle":
                values[f"{bone}.radius"] = surface.radius * content.scale
        return {
            f"/**/{Parameters.node}": given | values | joint,
            f"/**/{LoadParameters.node}": {"person.mass": float(content.mass), **joint},
        }

    def _file(self, name: str) -> Path:
        path = expand_user(name)
        beside = self.path.parent / path
        return path if path.is_absolute() else beside if beside.exists() else find_file(name)
