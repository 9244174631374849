"""Knees in lanes: the bits of runs, whoever is beside them; which knees those are, and that they are in vectors."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from llvmlite.binding import get_host_cpu_features
from numba import float64, int64, njit
from numba import typeof as type_of

from knee_contact_ros.compiled import lanes
from knee_contact_ros.compiled.functions import ENTRY, compiled_function
from knee_contact_ros.compiled.lanes import Tick, fits
from knee_contact_ros.compiled.transposed import numba_type_of
from knee_contact_ros.core import ticks
from knee_contact_ros.core.contact_laws import CONTACT_LAWS
from knee_contact_ros.core.model import KneeModel
from tests.compiled.test_batch import NO_HEIGHTS, one_by_one, together
from tests.compiled.test_compiled import FIRST, HOPPING, WALKING, knee

OTHERS: tuple[dict[str, Any], ...] = (
    {"contact.exponent": 1.4},
    {"fidelity.level": "quasi_static"},
    {"fidelity.budget": 300},
    {"drive": "displacement"},
)
"""Knees that do not fit for their numbers"""


def drawn_knee(config: Path, drawn: np.random.Generator, **numbers: Any) -> KneeModel:
    """One with a contact of any hardness and damping, as exact as a part of the depth or as next to nothing of it."""
    return knee(
        config, FIRST, "kelvin_voigt",
        **{
            "femur.mass": float(drawn.uniform(0.3, 20.0)), "contact.damping": float(drawn.choice([0.0, 300.0, 5000.0])),
            "contact.stiffness": float(drawn.uniform(1e7, 3e8)),
            "fidelity.level": str(drawn.choice(["dynamic", "auto"])),
            "fidelity.tolerance": 10.0 ** -float(drawn.uniform(3.0, 9.0)),
            "contact.allow_tension": bool(drawn.uniform() < 0.2),
        } | numbers,
    )  # fmt: skip


@pytest.mark.xdist_group("kernel for kelvin_voigt")
@pytest.mark.parametrize("seed", range(3))
def test_the_bits_are_those_of_runs_whoever_is_in_the_other_lanes(config: Path, seed: int) -> None:
    drawn = np.random.default_rng(seed)
    models = [drawn_knee(config, drawn, **(OTHERS[i % 3] if i % 5 == 4 else {})) for i in range(29)]
    loads = np.stack([10.0 ** drawn.uniform(-2.0, 0.2) * (HOPPING, WALKING, WALKING)[i % 3] for i in range(29)])
    assert sum(fits(model.scene) for model in models) == 24
    expected = one_by_one(models, NO_HEIGHTS, loads)
    for i in range(seed, 29, 7):
        assert expected[i].tobytes() == one_by_one([models[i]], NO_HEIGHTS, loads[i : i + 1], ticks.run).tobytes()
    for threads in (1, 2, 5):
        assert together(models, NO_HEIGHTS, threads, loads).tobytes() == expected.tobytes()


def test_who_fits_does_so_by_law_surfaces_mechanism_and_numbers(config: Path) -> None:
    for law in CONTACT_LAWS:
        assert fits(knee(config, FIRST, law).scene) == (law in {"kelvin_voigt", "hertz"}), law
    for part in ({"femur": "profile"}, {"tibia": "circle"}, {"mechanism": "table"}):
        assert not fits(knee(config, FIRST._replace(**part), "kelvin_voigt").scene)  # type: ignore[arg-type]
    for numbers in OTHERS:
        assert not fits(knee(config, FIRST, "kelvin_voigt", **numbers).scene)


def test_nobody_fits_where_vectors_have_another_exponential_function(
    config: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(lanes.config, "USING_SVML", True)
    assert not fits(knee(config, FIRST, "kelvin_voigt").scene)


def test_loops_of_two_kinds_are_not_taken_for_each_other(config: Path) -> None:
    """Code is linked by names: one from the cache replaced another's of the same name in the same process."""
    names = {
        loop(lanes._places(type_of(knee(config, FIRST, law).scene))).__qualname__
        for law in ("kelvin_voigt", "hertz")
        for loop in (lanes._begin_all, lanes._stride_all, lanes._arrive_all)
    }
    assert len(names) == 6


@pytest.mark.skipif(not get_host_cpu_features().get("avx2"), reason="its vectors are too short to be worth it")
@pytest.mark.parametrize(
    ("make", "more"), [(lanes._begin_all, ()), (lanes._stride_all, (float64,)), (lanes._arrive_all, ())]
)
def test_the_loops_over_lanes_are_vectors(config: Path, make: Any, more: tuple[Any, ...]) -> None:
    """One branch too many, and they are right but no quicker than one knee after the other."""
    compiled_function(ticks.run)
    loop: Any = njit(**ENTRY)(make(lanes._places(type_of(knee(config, FIRST, "kelvin_voigt").scene))))
    loop.compile((int64, numba_type_of(Tick), *more))
    (code,) = loop.inspect_asm().values()
    assert re.search(r"\bv?sqrtpd\b", code)
    assert not re.search(r"\bv?sqrtsd\b", code)
