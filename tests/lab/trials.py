"""A made-up trial as a laboratory would have it: cells of a tray in one file, motion capture in another."""

import numpy as np

RATE, SECONDS = 120.0, 6.0
OFFSET, DELAY = -12.0, 0.021
"""What makes the goniometer right [deg], and how late it is [s]"""
WEIGHT = 700.0
MAP = """\
time: {column: time_s}
angle: {column: goniometer_deg, unit: deg}
reference: {column: knee_flexion_deg, unit: deg, sign: -1}
load:
  columns: {pm_n: 1, am_n: 1, al_n: 1, pl_n: 1}
  unit: N
body_weight: 700.0
"""


def flexion(time):
    """Of a walking knee [deg], in strides that differ a little."""
    phase = 2.0 * np.pi * (time / 1.1 + 0.02 * np.sin(1.3 * time))
    return 25.0 - 22.0 * np.cos(phase) - 9.0 * np.cos(2.0 * phase - 0.9)


def load(time):
    """Of a walking knee [N]."""
    phase = 2.0 * np.pi * time / 1.1
    return 1100.0 + 600.0 * np.sin(phase) + 250.0 * np.cos(2.0 * phase)


def cells(noise=0.0, seed=1):
    """The tray's file: times, four cells and the goniometer, with noise [deg]."""
    time = np.arange(round(SECONDS * RATE)) / RATE
    parts = {"pm_n": 0.4, "am_n": 0.2, "al_n": 0.1, "pl_n": 0.3}
    angle = (
        flexion(time - DELAY) - OFFSET + noise * np.random.default_rng(seed).normal(size=len(time))
    )
    return {
        "time_s": time,
        **{name: part * load(time) for name, part in parts.items()},
        "goniometer_deg": angle,
    }


def motion():
    """Motion capture, with flexion negative and other times."""
    time = np.arange(round(SECONDS * 100.0)) / 100.0 + 0.003
    return {"time_s": time, "knee_flexion_deg": -flexion(time)}


def write_csv(path, columns, delimiter=",", decimal=".", top=""):
    """A table with its names on top."""
    rows = [delimiter.join(columns)]
    rows += [
        delimiter.join(
            cell if isinstance(cell, str) else f"{cell:.6f}".replace(".", decimal) for cell in row
        )
        for row in zip(*columns.values(), strict=True)
    ]
    path.write_text(top + "\n".join(rows) + "\n", encoding="utf-8")
    return path


def write_trial(folder, noise=0.0):
    """Both files and the map."""
    (folder / "map.yaml").write_text(MAP, encoding="utf-8")
    return (
        write_csv(folder / "trial_motion.csv", motion()),
        write_csv(folder / "trial_cells.csv", cells(noise)),
        folder / "map.yaml",
    )
