"""Groups of parameters that all nodes of the package have in common."""

from __future__ import annotations

from typing import Annotated, Any, ClassVar

from pydantic import BaseModel, ConfigDict, Field

from knee_contact_ros.parameters.limits import OffOrAtLeast


class Section(BaseModel):
    """Group of parameters; names and types are strict, numbers finite."""

    model_config = ConfigDict(strict=True, extra="forbid", frozen=True, allow_inf_nan=False)


def frame_name(name: str) -> str:
    """Check the name of a tf2 frame, which may be empty.

    Raises:
        ValueError: it begins with a slash, or is the suffix of a tibia frame alone.
    """
    if name.startswith("/") or name == "_isb":
        raise ValueError("allowed: the name of a tf2 frame, without a slash before it")
    return name


class Pairing(Section):
    """Pairing of angle and force samples by their stamps."""

    wait: float = Field(
        0.1, ge=0.0, le=10.0, description="[s] how long a force waits for an angle at or after its stamp"
    )
    max_gap: float = Field(
        0.1, gt=0.0, le=3600.0, description="[s] largest gap between stamps that is not flagged stale"
    )
    angle_delay: float = Field(
        0.0, ge=-1.0, le=1.0, description="[s] by which the angles lag the forces: they are paired so much earlier"
    )
    queue: int = Field(
        20_000, ge=100, le=10**7, description="samples of a stream that may wait for the other one, at most"
    )


class Diagnostics(Section):
    """Limits of the inputs beyond which `/diagnostics` warns or reports an error."""

    angle_warn_rate: float = Field(0.0, ge=0.0, le=1e5, description="[Hz] of the angles, below which it warns; 0: off")
    angle_error_rate: float = Field(0.0, ge=0.0, le=1e5, description="[Hz] below which that is an error; 0: off")
    force_warn_rate: float = Field(0.0, ge=0.0, le=1e5, description="[Hz] of the forces, below which it warns; 0: off")
    force_error_rate: float = Field(0.0, ge=0.0, le=1e5, description="[Hz] below which that is an error; 0: off")
    timeout: float = Field(1.0, gt=0.0, le=3600.0, description="[s] of silence, from which on an input is stale")


def queue(answers: int) -> Any:
    """Field for the number of answers that may wait for an output's process; `answers` is the default."""
    return Field(answers, ge=100, le=10_000_000, description="answers that may wait for its process")


def queue_size(size: float) -> Any:
    """Field for the memory that answers may take while they wait; `size` [MB] is the default."""
    return Field(size, ge=1.0, le=1e5, description="[MB] of memory that these may take")


# A section of an output names the module that describes it: see `sinks/protocol.py`.


class Record(Section):
    """Recording to MCAP."""

    output: ClassVar[str] = "knee_contact_ros.bags.answer_recorder"

    path: str = Field("", description="MCAP file to write, {stamp} in it: when; empty: none")
    flush_period: float = Field(0.03, ge=0.001, le=60.0, description="[s] what a crash of the programs may lose")
    sync_period: Annotated[float, OffOrAtLeast(0.05)] = Field(
        1.0, le=3600.0, description="[s] what a power failure may lose; 0: off"
    )
    max_size: Annotated[float, OffOrAtLeast(0.1)] = Field(
        0.0, le=1e9, description="[MB] of a file, from which on the recording goes on in a new one; 0: off"
    )
    max_duration: Annotated[float, OffOrAtLeast(1.0)] = Field(
        0.0, le=1e9, description="[s] of stamps in a file, from which on the recording goes on in a new one; 0: off"
    )
    min_free: float = Field(
        100.0, ge=0.0, le=1e9, description="[MB] that stay free on the disk: a recording ends before it takes them"
    )
    queue: int = queue(30_000)
    queue_size: float = queue_size(100.0)
