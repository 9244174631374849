"""The map of `import-csv` and `align`: what the columns of a laboratory's files are, and their units."""

from __future__ import annotations

import difflib
from pathlib import Path
from typing import Annotated, Any

from pydantic import Field, ValidationError, model_validator

from knee_contact_ros.parameters.limits import OneOf
from knee_contact_ros.parameters.reading import first_error
from knee_contact_ros.parameters.sections import Section
from knee_contact_ros.system.errors import UsageError
from knee_contact_ros.system.yaml_file import read_mapping

REFUSE, LEAVE_OUT = "refuse", "leave_out"
COMPRESSION, TENSION = "compression", "tension"


class TableFormat(Section):
    """Format of the text files, where it cannot be recognised."""

    header_line: int | None = Field(None, ge=1, description="line with the names; default: the first with content")
    first_line: int | None = Field(None, ge=2, description="line of the first row; default: the one after the names")
    delimiter: str | None = Field(None, min_length=1, max_length=1, description="default: as the names are divided")
    decimal: Annotated[str, OneOf("auto", ".", ",")] = Field(
        "auto", description="auto: a comma where columns are not divided by commas"
    )


class TimeColumn(Section):
    """Column with the time of each row."""

    column: str = Field("time", min_length=1)
    unit: str = "s"
    offset: float = Field(0.0, description="[s] added, so that recordings with large times begin near 0")


class Channel(Section):
    """Column, or weighted sum of columns of a single file."""

    column: str | None = Field(None, min_length=1)
    columns: dict[str, float] | None = Field(None, min_length=1, description="names with weights")
    unit: str = Field(description="of the sum")
    scale: float = Field(1.0, description="which the sum is multiplied by, as a calibration says")
    file: str = Field("", description="pattern of the file's name, as *_motion.csv, if several have such columns")

    @model_validator(mode="after")
    def _one_way(self) -> Channel:
        if (self.column is None) == (self.columns is None):
            raise ValueError("allowed: either column or columns")
        if self.scale == 0.0 or not any(self.weights.values()):
            raise ValueError("allowed: a scale, and weights of which one at least, other than 0")
        return self

    @property
    def weights(self) -> dict[str, float]:
        """Weights by the names of the columns."""
        return self.columns if self.columns is not None else {str(self.column): 1.0}


class AngleChannel(Channel):
    """Flexion angle of the knee."""

    sign: Annotated[float, OneOf(1.0, -1.0)] = Field(1.0, description="1 if it grows in flexion, or -1")
    joint: str = Field("knee", min_length=1, description="name in joint_states")


class LoadChannel(Channel):
    """Axial load of the knee: the force that the femur exerts on the tibia, along the tibia."""

    direction: Annotated[str, OneOf(COMPRESSION, TENSION)] = Field(
        COMPRESSION, description="what a positive sum is; tension: as force.y of OpenSim's reaction on the tibia"
    )


class SensorMap(Section):
    """Content of a map."""

    table: TableFormat = TableFormat()
    time: TimeColumn = TimeColumn()
    angle: AngleChannel
    reference: AngleChannel | None = Field(None, description="the angle that align holds `angle` against")
    load: LoadChannel | None = None
    moment: Channel | None = Field(
        None, description="frontal moment about the middle of the plateau; > 0 loads the lateral compartment more"
    )
    side: Annotated[str, OneOf("right", "left")] = "right"
    body_weight: float | None = Field(None, gt=0.0, le=1e5, description="[N]")
    rate: float = Field(0.0, ge=0.0, le=1e4, description="[Hz] both are interpolated at; 0: every row keeps its stamp")
    max_gap: float = Field(0.1, gt=0.0, le=3600.0, description="[s] between rows, beyond which nothing is interpolated")
    missing: Annotated[str, OneOf(REFUSE, LEAVE_OUT)] = Field(
        REFUSE, description="what to do with a row that has no number (empty, NaN) where one is needed"
    )


def read_map(path: Path) -> SensorMap:
    """Read a map from a YAML file.

    Raises:
        UsageError: the file cannot be read, or has a name or value that is not allowed.
    """
    content = dict(read_mapping(path, "map", "names to values"))
    try:
        return SensorMap.model_validate(content)
    except ValidationError as error:
        raise UsageError(f"map {path}: {first_error(error)}{_meant(error)}") from None


def _meant(error: ValidationError) -> str:
    """Hint at the name that is close to an unknown one, or all the names; empty for other errors."""
    first = error.errors()[0]
    if first["type"] != "extra_forbidden":
        return ""
    model: Any = SensorMap
    for part in first["loc"][:-1]:
        field = model.model_fields[part]
        kinds = getattr(field.annotation, "__args__", (field.annotation,))
        model = next(kind for kind in kinds if isinstance(kind, type) and issubclass(kind, Section))
    near = difflib.get_close_matches(str(first["loc"][-1]), model.model_fields, n=1, cutoff=0.5)
    return f"; did you mean {near[0]}?" if near else f"; known are {', '.join(model.model_fields)}"
