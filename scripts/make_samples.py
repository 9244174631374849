"""Make the sample data of the tutorials from the shipped gait and profiles: `python -m scripts.make_samples`.

`examples/subject` looks like results of OpenSim and like cartilage meshes: the meshes are shipped profiles, swept
sideways. `examples/laboratory` looks like files of an instrumented knee: its cells and its goniometer are made up.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from knee_contact_ros.offline.notebooks import solve

Floats = NDArray[np.float64]
ROOT = Path(__file__).parents[1]
SUBJECT, LABORATORY = ROOT / "examples" / "subject", ROOT / "examples" / "laboratory"
SLICES = np.arange(-28.0, -7.0, 4.0) * 1e-3
"""Places of the swept profiles along z [m]"""
OFFSET, GAIN, LAG = 5.0, 0.87, 0.02
"""What the made goniometer is off by: [deg], factor, [s]"""
FOOT = "endheader"


def write_sto(path: Path, columns: dict[str, Floats], *, degrees: bool) -> None:
    """Write a table as OpenSim does."""
    rows = np.column_stack(list(columns.values()))
    header = [
        path.stem,
        "version=1",
        f"nRows={len(rows)}",
        f"nColumns={rows.shape[1]}",
        f"inDegrees={'yes' if degrees else 'no'}",
        FOOT,
        "\t".join(columns),
    ]
    np.savetxt(path, rows, fmt="%.6g", delimiter="\t", header="\n".join(header), comments="")


def write_csv(path: Path, columns: dict[str, Floats]) -> None:
    """Write a table with a line of names."""
    np.savetxt(
        path,
        np.column_stack(list(columns.values())),
        fmt="%.6g",
        delimiter=",",
        header=",".join(columns),
        comments="",
    )


def write_stl(path: Path, profile: Floats) -> None:
    """Write a profile, swept along z with a slight bend, as a binary STL file."""
    bend = 30.0 * (SLICES - SLICES.mean()) ** 2  # [m]: 1.7 mm at the edges
    points = np.array(
        [[(x, y + up, z) for x, y in profile] for z, up in zip(SLICES, bend, strict=True)]
    )
    a = points[:-1, :-1]
    b = points[1:, :-1]
    c = points[1:, 1:]
    d = points[:-1, 1:]
    corners = np.concatenate([np.stack([a, b, c], -2), np.stack([a, c, d], -2)]).reshape(-1, 3, 3)
    facets = np.zeros(
        len(corners), dtype=[("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("unused", "<u2")]
    )
    facets["corners"] = corners
    path.write_bytes(bytes(80) + np.uint32(len(facets)).tobytes() + facets.tobytes())


def main() -> None:
    """Write all samples."""
    for folder in (SUBJECT, LABORATORY):
        folder.mkdir(exist_ok=True)
    gait = solve(ROOT / "bags" / "gait2354_right")
    time = gait.time
    angle = np.degrees(gait.flexion_angle)
    axial = 2.0 * gait.load
    write_sto(SUBJECT / "walk_q.sto", {"time": time, "knee_angle_r": -angle}, degrees=True)
    name = "knee_r_on_tibia_r_in_tibia_r_"
    nothing = np.zeros(len(time))
    reaction = {
        f"{name}{part}": nothing for part in ("fx", "fy", "fz", "mx", "my", "mz", "px", "py", "pz")
    }
    write_sto(
        SUBJECT / "walk_jr.sto", {"time": time, **reaction, f"{name}fy": -axial}, degrees=False
    )
    for bone, reduced in (("femur", 3), ("tibia", 1)):
        lines = (ROOT / "config" / f"{bone}_medial.csv").read_text(encoding="utf-8").splitlines()
        points = np.array([line.split(",") for line in lines if line[0] not in "#x"], dtype=float)
        write_stl(SUBJECT / f"{bone}_cartilage.stl", points[::reduced])

    random = np.random.default_rng(1)
    share = 0.62 + 0.1 * np.sin(np.radians(4.0 * angle))
    medial = share * axial
    lateral = (1.0 - share) * axial
    cells = {
        "time_s": time,
        "am_n": 0.4 * medial,
        "pm_n": 0.6 * medial,
        "al_n": 0.45 * lateral,
        "pl_n": 0.55 * lateral,
    }
    write_csv(LABORATORY / "cells.csv", cells)
    late = (
        GAIN * np.interp(time - LAG, time, angle)
        - OFFSET
        + 0.5 * random.standard_normal(len(time))
    )
    write_csv(
        LABORATORY / "motion.csv",
        {"time_s": time, "goniometer_deg": late, "knee_flexion_deg": -angle},
    )


if __name__ == "__main__":
    main()
