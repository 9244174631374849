"""The knees of the study, as its study file lists them: share of the load, layer, second stiffness."""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from knee_contact_ros.lab.study import read_study
from knee_contact_ros.parameters.files import load_parameters

Floats = NDArray[np.float64]
ROOT = Path(__file__).parents[2]
STUDY = Path(__file__).with_name("study.yaml")
BAG = ROOT / "bags" / "gait2354_right"
HEALTHY, ARTHRITIC = "healthy", "osteoarthritis"
SHARE, LAYER, SECOND = "load.share", "contact.layer_depth", "contact.stiffness_2"
SHIPPED = load_parameters(ARTHRITIC).contact
"""The arthritic knee's contact as it is shipped: 0.5 mm on bone"""
FIRST = SHIPPED.stiffness
"""K₁ [N/m^1.5], the healthy knee's stiffness too"""


class Grid(NamedTuple):
    """Values that are all combined; tables of outcomes have their shape."""

    shares: Floats
    layers: Floats
    """Thicknesses of the first layer [m]"""
    seconds: Floats
    """Stiffnesses of the second layer, K₂ [N/m^1.5]"""

    @property
    def shape(self) -> tuple[int, int, int]:
        """Numbers of shares, layers and second stiffnesses."""
        return len(self.shares), len(self.layers), len(self.seconds)

    def values(self, share: int | None = None) -> dict[str, Floats]:
        """Parameters of all cases, or of one share, in the order of a table's cells."""
        shares = self.shares if share is None else self.shares[[share]]
        columns = np.meshgrid(shares, self.layers, self.seconds, indexing="ij")
        return {name: column.ravel() for name, column in zip((SHARE, LAYER, SECOND), columns, strict=True)}


def whole() -> Grid:
    """The grid of the study file."""
    grid = read_study(STUDY).grid
    return Grid(*(np.array(grid[name]) for name in (SHARE, LAYER, SECOND)))
