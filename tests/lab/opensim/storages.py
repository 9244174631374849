"""Small storage files as OpenSim writes them, made by the tests."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np

AXES = ("fx", "fy", "fz", "mx", "my", "mz", "px", "py", "pz")
TIBIA = "knee_{0}_on_tibia_{0}_in_tibia_{0}_"
DURATION = 1.2
"""[s] of a step and a bit"""


def write_storage(path: Path, time: np.ndarray, columns: Mapping[str, np.ndarray], degrees: str | None = None) -> Path:
    """A file with these columns; `degrees` is the header's inDegrees, if it has one."""
    header = [path.stem, "version=1", f"nRows={len(time)}", f"nColumns={len(columns) + 1}"]
    header += [f"inDegrees={degrees}"] if degrees else []
    rows = np.column_stack([time, *columns.values()])
    lines = [*header, "", "Units are S.I. units", "endheader", "\t".join(["time", *columns])]
    lines += ["\t".join(f"{value:20.12f}" for value in row) for row in rows]
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return path


def flexion(time: np.ndarray) -> np.ndarray:
    """Like a walking knee's [rad]: from 3 to 63 degrees."""
    return np.radians(33.0 - 30.0 * np.cos(2.0 * np.pi * time / DURATION))


def kinematics(
    path: Path, sign: float = -1.0, unit: str = "deg", header: str | None = "yes", names: str = "knee_angle_{}"
) -> Path:
    """Angles of both knees, the left one half a step later."""
    time = np.linspace(0.0, DURATION, 121)
    factor = np.degrees(1.0) if unit == "deg" else 1.0
    columns = {names.format(side): sign * factor * flexion(time + shift) for side, shift in (("r", 0.0), ("l", 0.6))}
    hip = {"hip_flexion_r": 20.0 * np.sin(time), "knee_angle_r_beta": columns[names.format("r")]}
    return write_storage(path, time, hip | columns, header)


def reaction_columns(time: np.ndarray, sign: float = 1.0) -> list[np.ndarray]:
    """What acts on a tibia, one column an axis: two load peaks, and something on every other axis."""
    load = 900.0 + 900.0 * np.sin(2.0 * np.pi * time / DURATION) ** 2
    return [sign * values for values in (0.1 * load, -load, 60.0 + time, 9.0 + time, 3.0 - time, 1.0 + time)]


def reactions(path: Path, prefix: str = TIBIA, sign: float = 1.0, rows: int = 1201, end: float = DURATION) -> Path:
    """Reactions of both knees, without points of application but zeros."""
    time = np.linspace(0.0, end, rows)
    values = [*reaction_columns(time, sign), *[np.zeros_like(time)] * 3]
    columns = {prefix.format(side) + axis: column for side in "rl" for axis, column in zip(AXES, values, strict=True)}
    return write_storage(path, time, columns, "no")
