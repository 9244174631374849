"""Reference solutions of scenes, kept on disk, as they depend on the scene and the reference alone."""

from __future__ import annotations

import functools
import hashlib
import tempfile
from pathlib import Path

import numpy as np

from studies.honesty.scenes import Scene
from studies.reference import LAWS, Knee, Solution, solve
from studies.reference.library import SOURCE, cache_folder


@functools.cache
def _folder() -> Path:
    """Folder of the solutions by the present reference."""
    digest = hashlib.sha256()
    for path in sorted(SOURCE.iterdir()):
        if path.suffix in {".c", ".h", ".py"}:
            digest.update(path.read_bytes())
    folder = cache_folder() / f"solutions-{digest.hexdigest()[:16]}"
    folder.mkdir(parents=True, exist_ok=True)
    return folder


def knee_of(scene: Scene) -> Knee:
    """Knee of a scene in the form that the reference takes."""
    law = LAWS[scene.law](**scene.arguments)
    return Knee(law, scene.mass, scene.half_axes, scene.slope, scene.allow_tension)


def reference(scene: Scene) -> Solution:
    """Solve a scene by the reference, or read its solution if it is kept."""
    path = _folder() / f"{scene.content()}.npy"
    if path.exists():
        return Solution(*np.load(path))
    solution = solve(knee_of(scene), scene.time, scene.angle, scene.load)
    with tempfile.NamedTemporaryFile(dir=path.parent, suffix=".npy", delete=False) as file:
        np.save(file, np.stack(solution))
    Path(file.name).replace(path)
    return solution
