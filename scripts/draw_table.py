"""Draw where the search of a knee's common normal starts: python -m scripts.draw_table PARAMETERS... OUT.png."""

from __future__ import annotations

import sys

import matplotlib as mpl
import numpy as np

from knee_contact_ros import load_model

mpl.use("Agg")
from matplotlib import pyplot as plt


def draw(sources: list[str], output: str) -> None:
    """Draw the starts of each cell over flexion: how many there are, and where on the tibia they lie."""
    table = load_model(sources).pair.table()
    heights, begins, starts = table["cells"], table["begins"], table["starts"]
    columns, rows = len(heights), heights.shape[1] - 1
    cells = np.repeat(np.arange(columns * rows), np.diff(begins))
    flexion = np.degrees(table["edges"])
    figure, (upper, lower) = plt.subplots(2, 1, figsize=(8, 6), sharex=True, layout="constrained")
    counts = np.diff(begins).reshape(columns, rows)
    drawn = upper.pcolormesh(flexion, np.arange(rows + 1), counts.T, cmap="viridis", vmin=1)
    figure.colorbar(drawn, ax=upper, label="starts in the cell")
    upper.set(ylabel="layer, from apart (0) to deep", title=" + ".join(sources))
    dots = lower.scatter(
        0.5 * (flexion[1:] + flexion[:-1])[cells // rows], 1e3 * starts[:, 3], s=2, c=cells % rows, cmap="plasma"
    )
    figure.colorbar(dots, ax=lower, label="layer")
    lower.set(xlabel="flexion [deg]", ylabel="place on the tibia, x [mm]", xlim=(-20.0, 140.0), ylim=(-5.0, 20.0))
    lower.grid(alpha=0.3)
    figure.savefig(output, dpi=110)


if __name__ == "__main__":
    draw(sys.argv[1:-1], sys.argv[-1])
