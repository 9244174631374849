"""VTK's files in a process of its own: `INPUT OUTPUT` writes points, triangles and space of a mesh as .npz.

VTK checks no indices, so a damaged file may end its process by a signal.
"""

import sys
from pathlib import Path
from typing import Any

import numpy as np


def main(path: str, output: str) -> None:
    """Read a file by VTK, the only library that reads VTP and VTK, and write what it holds."""
    import pyvista
    from vtkmodules.vtkCommonCore import vtkObject

    vtkObject.GlobalWarningDisplayOff()  # its lines on a damaged file are many
    with pyvista.vtk_verbosity("off"):
        read: Any = pyvista.read(path)
    if not isinstance(read, pyvista.PolyData):
        read = read.extract_surface()
    space = "".join(map(str, read.field_data["SPACE"])) if "SPACE" in read.field_data else ""
    mesh = read.triangulate().clean()
    has_faces = bool(mesh.n_cells and mesh.faces.size)
    with Path(output).open("wb") as file:  # to whose name nothing is added
        np.savez(
            file,
            points=mesh.points if has_faces else read.points,
            triangles=mesh.regular_faces if has_faces else np.empty((0, 3), np.int64),
            space=space,
        )


if __name__ == "__main__":
    main(*sys.argv[1:])
