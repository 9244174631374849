"""The surface of one label of a label map (NIfTI), as a segmentation of MRI gives it."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from knee_contact_ros.core.arrays import Floats, Integers
from knee_contact_ros.system.errors import UsageError

LABEL_MAPS = (".nii", ".nii.gz")
INSIDE = 0.5
MOST_SHOWN = 12
"""Labels that a message lists"""


def read_label_map(path: Path, label: int | None) -> tuple[Floats, Integers]:
    """Points [the file's unit, scanner axes] and triangles around the voxels of a label.

    Raises:
        UsageError: not readable, not three-dimensional, or without that label.
    """
    import nibabel
    import pyvista

    try:
        image: Any = nibabel.load(path)
        values = np.asarray(image.dataobj)
    except Exception as error:  # nibabel raises its own, EOFError, zlib's and more
        raise UsageError(f"{path} cannot be read: {' '.join(str(error).split())[:200]}") from None
    values = values.reshape(values.shape[:3]) if values.ndim > 3 and set(values.shape[3:]) == {1} else values
    if values.ndim != 3:
        raise UsageError(f"{path} has {values.ndim} dimensions; a label map has 3")
    mask = chosen(path, values, label)
    padded = np.pad(mask, 1).astype(np.float32)  # a label at the edge of the image is closed there
    grid = pyvista.ImageData(dimensions=padded.shape, origin=(-1.0, -1.0, -1.0))
    grid.point_data["inside"] = padded.ravel(order="F")
    mesh = grid.contour([INSIDE], scalars="inside").triangulate()
    voxels = np.asarray(mesh.points, np.float64)
    affine = np.asarray(image.affine, np.float64)
    return voxels @ affine[:3, :3].T + affine[:3, 3], np.asarray(mesh.regular_faces, np.int64)


def chosen(path: Path, values: Any, label: int | None) -> Any:
    """Where the label is."""
    labels = [float(value) for value in np.unique(values) if value != 0]
    shown = ", ".join(f"{value:g}" for value in labels[:MOST_SHOWN]) + (", ..." if len(labels) > MOST_SHOWN else "")
    if label is None and len(labels) != 1:
        raise UsageError(f"{path} needs --label N: it has the labels {shown or '(none but 0)'}")
    wanted = labels[0] if label is None else float(label)
    mask = values == wanted
    if wanted == 0.0 or not mask.any():
        raise UsageError(f"--label {wanted:g}: {path} has the labels {shown or '(none but 0)'}")
    return mask
