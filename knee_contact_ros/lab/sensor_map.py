"""The map of a laboratory's columns to the channels of a gait bag, as `knee-contact import-csv` takes it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any

from pydantic import Field, ValidationError, model_validator

from ..parameters.sections import Section, first_error, one_of
from ..system.errors import UsageError, suggest
from ..system.files import find_file, read_mapping
from . import gait_bag
from .headers import TableFormat
from .plates import Plates
from .tables import TimeColumn
from .units import ColumnName

GROUND_CHANNELS = (
    "ground_force_x",
    "ground_force",
    "ground_force_z",
    "ground_torque_x",
    "ground_torque_y",
    "ground_torque_z",
)
"""Channels of the ground's wrench in the order of its components; an insole has only the second"""
JOINT_CHANNELS = {"angle": "assistance", "hip": "", "ankle": "ankle_assistance"}
"""Channels of joint angles, with those of the torques of their actuators"""
IMPORTED = (
    *JOINT_CHANNELS,
    "pelvis",
    *filter(None, JOINT_CHANNELS.values()),
    "load",
    "moment",
    "net_force",
    "net_moment",
    *GROUND_CHANNELS,
)
"""Channels that `import-csv` imports"""


class MapChannel(Section):
    """A column, or a weighted sum of columns, of one file."""

    column: ColumnName | None = None
    """Name, or place from 1"""
    columns: dict[ColumnName, float] | None = Field(None, min_length=1)
    """Names or places, with weights"""
    unit: str
    """Of the sum"""
    scale: float = 1.0
    """Which the sum is multiplied by, as a calibration says"""
    offset: float = 0.0
    """In `unit`, added at the end, behind scale, sign and direction"""
    file: str = ""
    """Pattern of the file's name, like *_motion.csv, if several have such columns"""
    time: TimeColumn | None = None
    """Its own, where it has another clock or unit than the map's `time`"""

    @model_validator(mode="after")
    def _one_way(self) -> MapChannel:
        ways = self.column, self.columns, getattr(self, "orientations", None)
        if sum(way is not None for way in ways) != 1:
            raise ValueError("allowed: either column or columns")
        if self.scale == 0.0 or not any(self.weights.values()):
            raise ValueError("allowed: a scale and at least one weight that are not 0")
        return self

    @property
    def weights(self) -> dict[ColumnName, float]:
        """Weights by the names or places of the columns."""
        return self.columns or ({} if self.column is None else {self.column: 1.0})

    @property
    def orientation(self) -> float:
        """Factor, 1 or -1, that converts the quantity to our sign."""
        return 1.0


class SignedChannel(MapChannel):
    """Angle of a joint, torque of its actuator, or a component of the ground's wrench."""

    sign: Annotated[float, one_of(1.0, -1.0)] = 1.0
    """1 if it is positive as ours is, or -1"""

    @property
    def orientation(self) -> float:
        """Factor, 1 or -1, that converts the quantity to our sign."""
        return self.sign


class Orientations(Section):
    """Orientations of two inertial sensors as quaternions, in columns of one file."""

    thigh: ColumnName | list[ColumnName]
    """Columns w, x, y, z; or what stands before .w, .x, .y, .z in their names"""
    shank: ColumnName | list[ColumnName]
    """Likewise"""
    standing: float = Field(1.0, ge=0.0, le=3600.0)
    """[s] of standing at the beginning, which is the zero; 0: the axes agree in a straight knee"""

    @property
    def names(self) -> list[ColumnName]:
        """Columns of the thigh's quaternion, then of the shank's."""
        return [
            name
            for given in (self.thigh, self.shank)
            for name in (
                given if isinstance(given, list) else [f"{given}.{part}" for part in "wxyz"]
            )
        ]

    @model_validator(mode="after")
    def _whole(self) -> Orientations:
        if len(set(self.names)) != 8:
            raise ValueError("allowed: four different columns of each, w, x, y, z")
        return self


class AngleChannel(SignedChannel):
    """Flexion angle of the knee."""

    joint: str = Field(gait_bag.JOINT, min_length=1)
    """Name in joint_states"""
    orientations: Orientations | None = None
    """Of thigh and shank, in place of a column and its unit"""

    @model_validator(mode="before")
    @classmethod
    def _in_radians(cls, values: Any) -> Any:
        if isinstance(values, dict) and values.get("orientations"):
            return {"unit": "rad", **values}
        return values

    @property
    def weights(self) -> dict[ColumnName, float]:
        """Weights by the names or places of the columns."""
        return (
            dict.fromkeys(self.orientations.names, 1.0) if self.orientations else super().weights
        )


class LoadChannel(MapChannel):
    """Axial load of the knee: the force that the femur exerts on the tibia, along the tibia."""

    direction: Annotated[str, one_of("compression", "tension")] = "compression"
    """What a positive sum is; tension: as force.y of OpenSim's reaction on the tibia"""

    @property
    def orientation(self) -> float:
        """Factor, 1 or -1, that converts the quantity to our sign."""
        return -1.0 if self.direction == "tension" else 1.0


class SensorMap(Section):
    """Content of a map."""

    table: TableFormat = TableFormat()
    time: TimeColumn = TimeColumn()
    angle: AngleChannel
    """Knee, positive in flexion"""
    hip: SignedChannel | None = None
    """Thigh to the vertical, positive with the knee ahead"""
    pelvis: SignedChannel | None = None
    """Its forward tilt, where `hip` is the angle of the thigh to the pelvis; taken off `hip`"""
    ankle: SignedChannel | None = None
    """Positive in dorsiflexion, 0 at a right angle"""
    assistance: SignedChannel | None = None
    """Torque of an actuator at the knee, in its angle's sense"""
    ankle_assistance: SignedChannel | None = None
    """Torque at the ankle, in its angle's sense"""
    reference: AngleChannel | None = None
    """The angle that align compares `angle` with"""
    load: LoadChannel | None = None
    moment: MapChannel | None = None
    """Frontal moment about the middle of the plateau; > 0 loads the lateral compartment more"""
    ground_force: SignedChannel | None = None
    """Vertical force of the ground on the foot, upwards"""
    ground_force_x: SignedChannel | None = None
    """Forwards"""
    ground_force_z: SignedChannel | None = None
    """To the right"""
    ground_torque_x: SignedChannel | None = None
    """About the ankle's centre, forwards"""
    ground_torque_y: SignedChannel | None = None
    """About the ankle's centre, upwards"""
    ground_torque_z: SignedChannel | None = None
    """About the ankle's centre, to the right"""
    net_force: LoadChannel | None = None
    """Axial force of the knee without muscles, by inverse dynamics"""
    net_moment: SignedChannel | None = None
    """Its net moment without an actuator's, positive if it extends the knee"""
    plates: Plates | None = None
    """Foot on the force plates of a C3D file, in place of the channels ground_*"""
    side: Annotated[str, one_of("right", "left")] = "right"
    body_weight: float | None = Field(None, gt=0.0, le=1e5)
    """[N]"""
    rate: float = Field(0.0, ge=0.0, le=1e4)
    """[Hz] of interpolation; 0: every row keeps its stamp"""
    max_gap: float = Field(0.1, gt=0.0, le=3600.0)
    """[s] between rows, beyond which nothing is interpolated"""
    missing: Annotated[str, one_of("refuse", "leave_out")] = "refuse"
    """What to do with a row that has no number (empty, NaN) where one is needed"""

    @model_validator(mode="after")
    def _complete(self) -> SensorMap:
        parts = {
            "ankle_assistance": "ankle",
            "pelvis": "hip",
            "moment": "load",
            "net_force": "net_moment",
            "net_moment": "net_force",
            **dict.fromkeys(GROUND_CHANNELS, "ground_force"),
        }
        for name, whole in parts.items():
            if getattr(self, name) is not None and getattr(self, whole) is None:
                raise ValueError(f"{name} needs {whole}")
        if self.plates and self.ground_force:
            raise ValueError("allowed: either plates or ground_force")
        return self


def read_map(paths: Sequence[Path]) -> SensorMap:
    """Read a map from YAML files, later ones overriding earlier ones; shipped maps may be given by their short names.

    Raises:
        UsageError: a file cannot be read, or has a name or value that is not allowed.
    """
    content: dict[str, Any] = {}
    for path in paths:
        shipped = find_file(f"maps/{path}.yaml")
        source = shipped if not path.exists() and shipped.exists() else path
        for name, value in read_mapping(source, "map", "names to values").items():
            before = content.get(name)
            merged = isinstance(before, Mapping) and isinstance(value, Mapping)
            content[name] = {**before, **value} if merged else value  # type: ignore[dict-item]
    try:
        return SensorMap.model_validate(content)
    except ValidationError as error:
        raise UsageError(f"map {paths[-1]}: {first_error(error)}{_suggestion(error)}") from None


def _suggestion(error: ValidationError) -> str:
    """Suggest the name that is closest to an unknown one; empty for other errors."""
    first = error.errors()[0]
    if first["type"] != "extra_forbidden":
        return ""
    sections = (
        SensorMap,
        TableFormat,
        TimeColumn,
        AngleChannel,
        LoadChannel,
        Orientations,
        Plates,
    )
    names = [name for section in sections for name in section.model_fields]
    return f"; {suggest(str(first['loc'][-1]), names)}"
