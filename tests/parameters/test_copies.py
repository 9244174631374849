"""Models are copied and sent to other processes."""

from __future__ import annotations

import copy
import importlib
import inspect
import pickle
import pkgutil
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from typing import Any

import numba
import numpy as np
import pytest

import knee_contact_ros.core
from knee_contact_ros import Results, load_model
from knee_contact_ros.core.contact_laws import CONTACT_LAWS
from knee_contact_ros.core.contact_pairs import TIBIAL_GEOMETRIES
from knee_contact_ros.core.geometries import GEOMETRIES
from knee_contact_ros.core.mechanisms import MECHANISMS
from knee_contact_ros.core.model import KneeModel
from knee_contact_ros.parameters.copies import MADE_OF_OTHERS
from tests.helpers.scenes import law, model

COPIES: dict[str, Callable[[KneeModel], KneeModel]] = {
    "pickle": lambda knee: pickle.loads(pickle.dumps(knee)),  # noqa: S301
    "old pickle": lambda knee: pickle.loads(pickle.dumps(knee, 2)),  # noqa: S301
    "copy": copy.copy,
    "deepcopy": copy.deepcopy,
}
POINTS = np.linspace(-0.03, 0.03, 41)
SURFACE = {"femur": (POINTS, 14.0 * POINTS**2 - 0.034), "tibia": (POINTS, 4.0 * POINTS**2)}


def pairs() -> dict[str, Any]:
    femora = {name: kind(0.034) if name == "circle" else kind(*SURFACE["femur"]) for name, kind in GEOMETRIES.items()}
    arguments: dict[str, tuple[Any, ...]] = {"plane": (0.05,), "circle": (0.095,), "profile": SURFACE["tibia"]}
    assert arguments.keys() == TIBIAL_GEOMETRIES.keys()
    return {
        f"{one} on {other}": make(femur, *arguments[other])
        for one, femur in femora.items()
        for other, make in TIBIAL_GEOMETRIES.items()
    }


MODELS: dict[str, KneeModel] = {
    **{f"law {name}": model(law(name)) for name in CONTACT_LAWS},
    **{name: model(law("hertz"), pair=pair) for name, pair in pairs().items()},
    **{
        name: model(law("hertz"), mechanism=make([0.0, 0.5, 1.0], [0.0, 0.003, 0.001]) if name == "table" else make())
        for name, make in MECHANISMS.items()
    },
}


def bits(knee: KneeModel) -> bytes:
    time = 0.002 * np.arange(6)
    return knee.run(time, 0.1 + time, 600.0 + 4e3 * time).tobytes()


@pytest.mark.parametrize("copied", COPIES.values(), ids=COPIES)
@pytest.mark.parametrize("knee", MODELS.values(), ids=MODELS)
def test_a_copy_gives_the_same_bits(knee: KneeModel, copied: Callable[[KneeModel], KneeModel]) -> None:
    other = copied(knee)
    assert bits(other) == bits(knee)
    assert numba.typeof(other.scene) == numba.typeof(knee.scene)  # or it would be compiled for again


def test_all_that_are_made_of_something_else_are_known() -> None:
    found = set[type]()
    for module in pkgutil.walk_packages(knee_contact_ros.core.__path__, "knee_contact_ros.core."):
        for kind in vars(importlib.import_module(module.name)).values():
            if inspect.isclass(kind) and issubclass(kind, tuple) and hasattr(kind, "_fields"):
                found |= {kind} if "__new__" in vars(kind) and tuple not in kind.__bases__ else set()
    assert found == set(MADE_OF_OTHERS)


@pytest.mark.parametrize("compiled", [None, False])
def test_a_loaded_model_works_in_another_process(compiled: bool | None) -> None:
    knee = load_model(["osteoarthritis", "mri_femur"], compiled=compiled)
    with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as pool:
        assert pool.submit(bits, knee).result(120.0) == bits(knee)
    assert isinstance(copy.deepcopy(knee).run([0.0], [0.1], [700.0]), Results)
