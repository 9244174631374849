"""`_replace` of named tuples in compiled code."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import pytest
from numba import njit
from numba.core.errors import TypingError

from knee_contact_ros.compiled.functions import ENTRY, register


class Alike(NamedTuple):
    one: float
    other: float


class Mixed(NamedTuple):
    number: float
    count: int
    alike: Alike
    array: np.ndarray


def changed(mixed: Mixed, count: int) -> Mixed:
    for _ in range(count):
        mixed = mixed._replace(number=mixed.number + mixed.array[0], count=7)
        mixed = mixed._replace(alike=mixed.alike._replace(other=2))
    return mixed


def test_the_same_as_in_python() -> None:
    register()
    mixed = Mixed(1.0, 2, Alike(3.0, 4.0), np.ones(2))

    def number(mixed: Mixed) -> tuple[Any, ...]:
        made = inner(mixed, 3)
        return made.number, made.count, made.alike

    inner = njit(**ENTRY)(changed)
    assert njit(**ENTRY)(number)(mixed) == (4.0, 7, (3.0, 2.0)) == changed(mixed, 3)[:3]


def test_a_name_that_is_no_field_is_refused() -> None:
    register()
    with pytest.raises(TypingError):
        njit(**ENTRY)(lambda alike: alike._replace(third=1.0))(Alike(1.0, 2.0))
