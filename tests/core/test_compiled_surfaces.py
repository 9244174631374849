"""Surfaces and mechanisms compiled: the same bits as the plain functions that they are compiled from."""

from __future__ import annotations

import importlib
import inspect
import math
import pkgutil
from collections.abc import Callable, Iterator
from functools import cache
from typing import Any

import numpy as np
import pytest

import knee_contact_ros.core
from knee_contact_ros.compiled.functions import compiled_function as compiled
from knee_contact_ros.core.contact_pairs import ContactPair, CurveContact, OnPlane
from knee_contact_ros.core.contact_pairs.tibial_circle import TibialCircle
from knee_contact_ros.core.contact_pairs.tibial_profile import TibialProfile
from knee_contact_ros.core.geometries import Circle, FemoralGeometry
from knee_contact_ros.core.kernel_source import METHODS
from knee_contact_ros.core.mechanisms import Hinge, Mechanism, ParallelMechanism, Table
from studies.accuracy import Forwards
from studies.ellipse import Ellipse
from tests.core.surfaces import noisy_femur, plateau
from tests.helpers.scenes import RADIUS

POSES = 300


def same_bits(one: np.ndarray, other: np.ndarray) -> bool:
    """Also the signs of zeros; only a nan has no bits of its own."""
    numbers = ~np.isnan(one)
    return np.array_equal(one, other, equal_nan=True) and np.array_equal(
        np.signbit(one[numbers]), np.signbit(other[numbers])
    )


def contacts(pair: ContactPair, poses: np.ndarray, moves: np.ndarray, answers: np.ndarray) -> None:
    """All that a kernel asks a pair for; the height moves to and fro."""
    for i in range(len(poses)):
        angle, x, height, way = float(poses[i, 0]), float(poses[i, 1]), float(poses[i, 2]), float(poses[i, 3])
        found = pair.closest(angle, x, height)
        answers[i, 0], answers[i, 1], answers[i, 2] = found.depth, found.extent, found.turning
        answers[i, 3], answers[i, 4] = found.normal_x, found.normal_y
        answers[i, 5] = pair.next_kink(angle, angle + way)
        answers[i, 6], answers[i, 7] = (
            pair.knot_spacing(),
            pair.largest_radius() + (1.0 if pair.is_non_convex() else 0.0),
        )
        at = pair.at(angle, way, x, -0.2)
        for k in range(len(moves)):
            depth, rate, cosine = at.touch(height + float(moves[k]))
            answers[i, 8 + 3 * k], answers[i, 9 + 3 * k], answers[i, 10 + 3 * k] = depth, rate, cosine


def translations(mechanism: Mechanism, angles: np.ndarray, answers: np.ndarray) -> None:
    for i in range(len(angles)):
        answers[i, 0], answers[i, 1] = mechanism.translation(float(angles[i]))
        answers[i, 2] = mechanism.largest_slope()


@cache
def kernel(function: Callable[..., None]) -> Callable[..., None]:
    return compiled(function)


FEMORA: dict[str, FemoralGeometry] = {"circle": Circle(RADIUS), "profile": noisy_femur(5e-5)}
TIBIAE = {"circle": TibialCircle(0.095), "profile": TibialProfile(*plateau(noise=1e-5))}
PAIRS: dict[str, ContactPair] = {
    "ellipse on plane": OnPlane(Ellipse(0.034, 0.028)),
    **{f"{name} on plane": OnPlane(femur, 0.1) for name, femur in FEMORA.items()},
    **{f"{one} on {two}": CurveContact(femur, tibia) for one, femur in FEMORA.items() for two, tibia in TIBIAE.items()},
}
MECHANISMS: dict[str, Mechanism] = {
    "hinge": Hinge(),
    "hinge in front": Hinge(0.01),
    "table": Table([-0.2, 0.0, 0.3, 1.1], [0.001, 0.0, 0.004, -0.006]),
    "parallel mechanism": ParallelMechanism().table,
    "closed form": Forwards(),
}


@pytest.mark.parametrize("pair", PAIRS.values(), ids=PAIRS)
def test_a_compiled_pair_gives_the_same_bits(pair: ContactPair) -> None:
    rng = np.random.default_rng(7)
    poses = np.stack(
        [
            rng.uniform(-0.5, 2.2, POSES),
            rng.uniform(-0.01, 0.01, POSES),
            rng.uniform(0.02, 0.04, POSES),
            rng.uniform(-1.0, 1.0, POSES),
        ],
        axis=1,
    )
    poses[:12, 2] = [1.0, 30.0, 1e6, 1e300, 0.01, 0.0, -1e-12, -0.1, -1e6, math.inf, -math.inf, math.nan]
    poses[12:16, 0], poses[16:20, 1] = [-10.0, 10.0, 0.0, math.pi], [0.0, 0.05, -3.0, 1e6]
    moves = np.array([0.0, 1e-6, 5e-5, -5e-5, 0.0])
    plain, fast = np.zeros((2, POSES, 8 + 3 * len(moves)))
    contacts(pair, poses, moves, plain)
    kernel(contacts)(pair, poses, moves, fast)
    assert same_bits(plain, fast)
    assert np.array_equal(plain[:, 8:11], plain[:, -3:], equal_nan=True)  # whatever was asked in between
    assert np.array_equal(plain[:, 0], plain[:, 8], equal_nan=True)


@pytest.mark.parametrize("mechanism", MECHANISMS.values(), ids=MECHANISMS)
def test_a_compiled_mechanism_gives_the_same_bits(mechanism: Mechanism) -> None:
    angles = np.concatenate([np.random.default_rng(8).uniform(-1.0, 3.0, POSES), [-0.2, 0.0, 0.3, 1.1, 10.0, math.nan]])
    plain, fast = np.zeros((2, len(angles), 3))
    translations(mechanism, angles, plain)
    kernel(translations)(mechanism, angles, fast)
    assert same_bits(plain, fast)


def named_tuples() -> Iterator[type[Any]]:
    """All that the core defines."""
    for module in pkgutil.walk_packages(knee_contact_ros.core.__path__, "knee_contact_ros.core."):
        for value in vars(importlib.import_module(module.name)).values():
            if inspect.isclass(value) and issubclass(value, tuple) and hasattr(value, "_fields"):
                yield value


def test_no_field_hides_behind_a_method_of_the_kernel() -> None:
    """In compiled code a method's name means the method, on every named tuple."""
    assert {kind.__name__: found for kind in named_tuples() if (found := set(kind._fields) & METHODS.keys())} == {}


def test_the_kernels_methods_are_written_as_its_interfaces_are() -> None:
    """Numba takes a method only if its parameters are written exactly as those of the interface."""
    surfaces = tuple(f"knee_contact_ros.core.{part}." for part in ("contact_pairs", "geometries", "mechanisms"))
    for kind in (kind for kind in named_tuples() if kind.__module__.startswith(surfaces)):
        for name in METHODS.keys() & vars(kind).keys():
            parameters = inspect.signature(getattr(kind, name)).parameters
            assert list(parameters.values()) == list(METHODS[name].parameters.values()), f"{kind.__name__}.{name}"
