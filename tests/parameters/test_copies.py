"""Models are copied and sent to other processes."""

from __future__ import annotations

import copy
import pickle
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from typing import Any

import numba
import numpy as np
import pytest

from knee_contact_ros import Results, load_model
from knee_contact_ros.model.knee import KneeModel
from knee_contact_ros.model.laws import CONTACT_LAWS
from knee_contact_ros.model.mechanisms import MECHANISMS
from knee_contact_ros.model.surfaces import GEOMETRIES, TIBIAL_GEOMETRIES, ContactPair
from tests.helpers.scenes import law, model

COPIES: dict[str, Callable[[KneeModel], KneeModel]] = {
    "pickle": lambda knee: pickle.loads(pickle.dumps(knee)),  # noqa: S301
    "old pickle": lambda knee: pickle.loads(pickle.dumps(knee, 2)),  # noqa: S301
    "copy": copy.copy,
    "deepcopy": copy.deepcopy,
}
POINTS = np.linspace(-0.03, 0.03, 41)
SURFACE = {"femur": (POINTS, 14.0 * POINTS**2 - 0.034), "tibia": (POINTS, 4.0 * POINTS**2)}
TABLE = [0.0, 0.5, 1.0], [0.0, 0.003, 0.001]


MECHANISM = {name: make(*(TABLE if name == "table" else ())) for name, make in MECHANISMS.items()}
FEMORA = {name: make(*(SURFACE["femur"] if name == "profile" else (0.034,))) for name, make in GEOMETRIES.items()}
ARGUMENTS: dict[str, tuple[Any, ...]] = {"plane": (0.05,), "circle": (0.095,), "profile": SURFACE["tibia"]}
TIBIAE = {name: make(*ARGUMENTS[name]) for name, make in TIBIAL_GEOMETRIES.items()}
MODELS: dict[str, KneeModel] = {
    **{f"law {name}": model(law(name)) for name in CONTACT_LAWS},
    **{
        f"{one} on {other}": model(law("hertz"), pair=ContactPair(femur, tibia, MECHANISM["hinge"]))
        for one, femur in FEMORA.items()
        for other, tibia in TIBIAE.items()
    },
    **{name: model(law("hertz"), mechanism=mechanism) for name, mechanism in MECHANISM.items()},
}


def bits(knee: KneeModel) -> bytes:
    time = 0.002 * np.arange(6)
    return knee.run(time, 0.1 + time, 600.0 + 4e3 * time).tobytes()


@pytest.mark.parametrize("copied", COPIES.values(), ids=COPIES)
@pytest.mark.parametrize("knee", MODELS.values(), ids=MODELS)
def test_a_copy_gives_the_same_bits(knee: KneeModel, copied: Callable[[KneeModel], KneeModel]) -> None:
    other = copied(knee)
    assert bits(other) == bits(knee)
    assert numba.typeof(other.knee) == numba.typeof(knee.knee) == numba.typeof(MODELS["law hertz"].knee)


@pytest.mark.parametrize("compiled", [None, False])
def test_a_loaded_model_works_in_another_process(compiled: bool | None) -> None:
    knee = load_model(["osteoarthritis", "mri_femur"], compiled=compiled)
    with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as pool:
        assert pool.submit(bits, knee).result(120.0) == bits(knee)
    assert isinstance(copy.deepcopy(knee).run([0.0], [0.1], [700.0]), Results)
