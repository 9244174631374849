"""Two trials of an instrumented knee, read from files that are not part of the project."""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from knee_contact_ros.lab.shares import Trial

Floats = NDArray[np.float64]
BODY_WEIGHT = 654.3
"""Body weight [N]"""
TRIALS = {"overground": "ngait_og5", "treadmill": "ngait_tm_fast1"}
MEDIAL = {"am_n": 0.9871, "pm_n": 0.9683, "al_n": 0.0387, "pl_n": 0.0211}
"""Weights of the tray's cells in the medial force: its published regression"""
ON_PLATE = 30.0
"""Vertical ground reaction [N] of a foot on the plate, above the noise of the plates in swing (19 and 23 N)"""


class Measured(NamedTuple):
    """Measured series of a trial, at the cells' samples, shape (n,)."""

    name: str
    time: Floats
    """Times [s]"""
    flexion: Floats
    """Flexion angle [rad] by inverse kinematics of markers"""
    total: Floats
    """Total force [N], the sum of the cells"""
    medial: Floats
    """Medial force [N]"""
    front: Floats
    """Part of the two medial cells' force that the anterior one bears [1]"""
    moment: Floats
    """Moment of inverse dynamics [N m] about x of the tibia, acting on it from above: adduction positive"""
    plate_time: Floats
    """Times of the plates' samples [s]"""
    plate: Floats
    """Vertical ground reaction of this leg [N]"""

    @property
    def trial(self) -> Trial:
        """The trial in the form that `fit-share` takes."""
        return Trial(self.name, self.flexion, self.total / BODY_WEIGHT, self.medial / BODY_WEIGHT, BODY_WEIGHT)

    def contacts(self) -> tuple[list[float], list[float]]:
        """Times [s] of heel strikes and toe-offs on the plate, without contacts that the trial's ends cut off."""
        on = self.plate > ON_PLATE
        changes = [
            self.plate_time[1:][now & ~before].tolist()
            for now, before in ((on[1:], on[:-1]), (~on[1:], ~on[:-1]))
        ]  # fmt: skip
        return changes[0], changes[1]


def is_there(folder: Path) -> bool:
    """Whether a folder has the trials."""
    return all((folder / f"{name}_tibia_cells.csv").is_file() for name in TRIALS.values())


def read(folder: Path) -> list[Measured]:
    """Read both trials, each where cells and motion were measured."""
    return [_read(folder, name, stem) for name, stem in TRIALS.items()]


def _read(folder: Path, name: str, stem: str) -> Measured:
    cells, motion, ground = (
        np.genfromtxt(folder / f"{stem}_{part}.csv", delimiter=",", names=True)
        for part in ("tibia_cells", "motion", "ground_force")
    )
    first = max(cells["time_s"][0], motion["time_s"][0])
    cells = cells[(cells["time_s"] >= first) & (cells["time_s"] <= motion["time_s"][-1])]
    degrees, moment = (
        np.interp(cells["time_s"], motion["time_s"], motion[column])
        for column in ("knee_flexion_deg", "knee_adduction_moment_nm")
    )
    return Measured(
        name, cells["time_s"], np.radians(-degrees), sum(cells[cell] for cell in MEDIAL),
        sum(factor * cells[cell] for cell, factor in MEDIAL.items()),
        cells["am_n"] / np.maximum(cells["am_n"] + cells["pm_n"], 1.0), moment, ground["time_s"], ground["f2_y_n"],
    )  # fmt: skip
