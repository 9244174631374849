"""A scene in memory: where Numba's own structures have its numbers."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numba import njit, typeof, types
from numba.extending import intrinsic

from knee_contact_ros.compiled.functions import ENTRY
from knee_contact_ros.compiled.layout import kind_of, laid_down, named_tuples, words_of
from knee_contact_ros.compiled.scene_memory import size_of
from knee_contact_ros.core.scene import Scene
from tests.compiled.test_compiled import LAWS, Combination, knee


@intrinsic
def put(_typing: Any, scene: Any, address: Any) -> Any:
    """Lay a scene down as Numba does."""

    def generate(context: Any, builder: Any, _signature: Any, arguments: Any) -> Any:
        place = context.get_value_type(scene).as_pointer()
        builder.store(arguments[0], builder.inttoptr(arguments[1], place))
        return context.get_dummy_value()

    return types.void(scene, address), generate


def lay_down(scene: Any, address: int) -> None:
    put(scene, address)


def arrays_in(part: Any) -> int:
    return sum(map(arrays_in, part)) if isinstance(part, tuple) else isinstance(part, np.ndarray)


@pytest.mark.parametrize(("combination", "law"), LAWS)
def test_all_numbers_lie_where_numba_puts_them(config: Path, combination: Combination, law: str) -> None:
    scene = knee(config, combination, law).scene
    (block,) = laid_down([scene], kind_of(scene))
    expected = np.zeros(size_of(typeof(scene)), np.uint8)
    njit(**ENTRY)(lay_down)(scene, expected.ctypes.data)
    assert len(block) == len(expected)
    ours, theirs = block.view(np.int64), expected.view(np.int64)
    differ = ours != theirs
    assert differ.sum() <= 2 * arrays_in(scene)  # who owns an array, which nobody asks for
    assert (ours[differ] == 0).all()


def test_kinds_differ_by_types_arrays_and_nothing_else(config: Path) -> None:
    first, same, other = (
        knee(config, LAWS[0].values[0], law, **more).scene
        for law, more in (("kelvin_voigt", {}), ("kelvin_voigt", {"femur.mass": 3.0}), ("hertz", {}))
    )
    assert kind_of(first) == kind_of(same) != kind_of(other)
    assert words_of(kind_of(first)) != words_of(kind_of(other))
    assert Scene in named_tuples(kind_of(first))
    numbers = np.zeros((2, 3))
    for array in (numbers.T, numbers[:, ::2], numbers[0], numbers.astype(int)):
        assert kind_of((array,)) != kind_of((numbers,))
