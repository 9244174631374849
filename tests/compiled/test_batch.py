"""Many knees in one call: the bits of a run of each, for every law, surface and drive, by however many threads."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from knee_contact_ros.compiled.batch import run_batch
from knee_contact_ros.compiled.kernel import compiled_kernel
from knee_contact_ros.core import ticks
from knee_contact_ros.core.model import KneeModel
from knee_contact_ros.core.types import ROW
from tests.compiled.test_compiled import ANGLE, HOPPING, LAWS, TIME, WALKING, Combination, knee

STEPS = np.diff(TIME, prepend=TIME[:1])
NO_HEIGHTS = np.full(len(TIME), np.nan)
LOADS = np.stack([WALKING, HOPPING, 0.5 * WALKING])
NUMBERS: tuple[dict[str, Any], ...] = (
    {},
    {"fidelity.tolerance": 1e-9, "femur.mass": 0.5},
    {"contact.exponent": 1.7, "contact.stiffness": 3e8, "fidelity.level": "quasi_static"},
)
"""Of three knees: they share a kernel"""
COMPILED = compiled_kernel().run


def one_by_one(
    models: list[KneeModel],
    heights: np.ndarray,
    loads: np.ndarray = LOADS,
    run: Callable[..., None] = COMPILED,
) -> np.ndarray:
    """The answers of runs, shape (k, n): compiled ones, which have the bits of plain ones (`test_compiled.py`)."""
    answers = np.zeros((len(models), len(TIME)), ROW)
    for model, load, own in zip(models, loads, answers, strict=True):
        run(model.scene, np.zeros(1, ticks.MEMORY), STEPS, ANGLE, load, heights, own)
    return answers


def together(models: list[KneeModel], heights: np.ndarray, threads: int, loads: np.ndarray = LOADS) -> np.ndarray:
    """The same by the batch."""
    answers = np.zeros((len(models), len(TIME)), ROW)
    run_batch([model.scene for model in models], STEPS, ANGLE, loads, heights, answers, threads=threads)
    return answers


@pytest.mark.parametrize(("combination", "law"), LAWS)
def test_the_bits_are_those_of_a_run_of_each(config: Path, combination: Combination, law: str) -> None:
    models = [knee(config, combination, law, **numbers) for numbers in NUMBERS]
    expected = one_by_one(models, NO_HEIGHTS)
    for threads in (1, 2):
        assert together(models, NO_HEIGHTS, threads).tobytes() == expected.tobytes()
    heights = expected["femoral_height"][0] + 6e-4 * np.sin(40.0 * TIME)
    displaced = [knee(config, combination, law, drive="displacement", **numbers) for numbers in NUMBERS]
    assert together(displaced, heights, 2).tobytes() == one_by_one(displaced, heights).tobytes()


@pytest.mark.xdist_group("kernel for kelvin_voigt")
def test_more_threads_than_knees_and_as_many_as_processors(config: Path) -> None:
    combination = LAWS[0].values[0]
    models = [knee(config, combination, "kelvin_voigt", **numbers) for numbers in NUMBERS]
    expected = one_by_one(models, NO_HEIGHTS).tobytes()
    for threads in (7, 0):
        assert together(models, NO_HEIGHTS, threads).tobytes() == expected
