"""docs/studies/osteoarthritis.csv: the knees at the first and the last share, a row for both drives."""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np

from studies.osteoarthritis.knees import Knees
from studies.osteoarthritis.maps import MM
from studies.osteoarthritis.theory import ratio

HEADER = (
    "share", "layer_mm", "stiffness_2", "force_drive_peak_n", "force_drive_over_healthy", "force_drive_depth_mm",
    "force_drive_second_layer_s", "force_drive_pressure_mpa", "displacement_peak_n", "displacement_over_healthy",
)  # fmt: skip


def write_csv(knees: Knees, path: Path) -> None:
    """Write the table to a file, with five digits."""
    forced, led, grid = ratio(knees, knees.forced), ratio(knees, knees.led), knees.grid
    with path.open("w", encoding="utf-8", newline="") as file:
        rows = csv.writer(file, lineterminator="\n")
        rows.writerow(HEADER)
        for cell in np.ndindex(grid.shape):
            if cell[0] in (0, len(grid.shares) - 1):
                numbers = (
                    grid.shares[cell[0]], MM * grid.layers[cell[1]], grid.seconds[cell[2]],
                    knees.forced.peak_force[cell], forced[cell], MM * knees.forced.peak_depth[cell],
                    knees.forced.bone_time[cell], 1e-6 * knees.forced.peak_pressure[cell], knees.led.peak_force[cell],
                    led[cell],
                )  # fmt: skip
                rows.writerow([f"{number:.5g}" for number in numbers])
