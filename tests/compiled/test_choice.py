"""Compiled or plain: what decides, and that it shows in no bit."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import knee_contact_ros
from knee_contact_ros.compiled import choice, kernel
from knee_contact_ros.compiled.choice import CHOSEN, COSTS, LOADING, SHIPPED, announcement, cost_of, worth_compiling
from knee_contact_ros.core.model import PLAIN, KneeModel
from tests.helpers.tiny_kernel import use_all

TIME = np.arange(0.0, 0.3, 0.005)
SERIES = (TIME, 0.4 + 0.3 * np.sin(7.0 * TIME), 900.0 + 600.0 * np.sin(13.0 * TIME))
KEPT = pytest.mark.xdist_group("kernel for kelvin_voigt")


def model(compiled: bool | None = None, **parameters: Any) -> KneeModel:
    return knee_contact_ros.load_model(parameters, compiled=compiled)


def kept(monkeypatch: pytest.MonkeyPatch, is_kept: bool, is_shipped: bool = False) -> None:
    monkeypatch.setattr(kernel, "is_kept", lambda _scene: is_kept)
    monkeypatch.setattr(kernel, "is_shipped", lambda _scene: is_shipped)


@pytest.mark.parametrize(
    ("source", "measured"),
    [
        ("healthy", 0),
        ("mri_femur", 0),
        ({"tibia.geometry": "circle"}, 0),
        (["mri_femur", {"tibia.geometry": "circle"}], 1),
        ("mri_knee", 2),
    ],
)
def test_as_many_ticks_as_take_as_long_as_compiling_are_compiled_for(
    source: Any, measured: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    knee, cost = knee_contact_ros.load_model(source), COSTS[measured]
    assert cost_of(knee.scene) is cost
    enough = int(cost.compiling / cost.tick) + 2
    kept(monkeypatch, is_kept=False)
    assert worth_compiling(knee.scene, enough)
    assert not worth_compiling(knee.scene, enough // 2)
    kept(monkeypatch, is_kept=True)
    assert worth_compiling(knee.scene, enough // 2)
    kept(monkeypatch, is_kept=False, is_shipped=True)
    enough = int(SHIPPED / cost.tick) + 2
    assert worth_compiling(knee.scene, enough)
    assert not worth_compiling(knee.scene, enough // 2)


def test_a_few_ticks_do_not_even_look_for_what_is_kept(monkeypatch: pytest.MonkeyPatch) -> None:
    scene = model().scene
    monkeypatch.setattr(choice, "_is_kept", lambda _scene: True)
    monkeypatch.delitem(sys.modules, choice._KERNEL)
    few = int(LOADING / COSTS[0].tick)
    assert not worth_compiling(scene, few - 1)
    assert worth_compiling(scene, few + 2)


def test_it_can_be_forced() -> None:
    assert model().kernel is CHOSEN
    assert model(compiled=False).kernel is PLAIN
    assert model(compiled=True).kernel is choice._compiled(model().scene)


@KEPT
@pytest.mark.parametrize(("is_kept", "is_shipped"), [(True, False), (False, True), (False, False)])
def test_the_choice_never_changes_a_bit(monkeypatch: pytest.MonkeyPatch, is_kept: bool, is_shipped: bool) -> None:
    compiled, plain = (model(compiled=way).run(*SERIES) for way in (True, False))
    assert compiled.tobytes() == plain.tobytes()
    kept(monkeypatch, is_kept, is_shipped)
    chosen = model()
    assert chosen.run(*SERIES).tobytes() == plain.tobytes()
    stream = chosen.stream()
    ticks = b"".join(stream.tick(*map(float, sample)).tobytes() for sample in zip(*SERIES, strict=True))
    assert ticks == plain.tobytes()


@KEPT
def test_arrays_of_any_kind_take_the_same_kernel() -> None:
    """A read-only or strided array would be a type of its own to the compiler, and another half minute."""
    knee = model(compiled=True)
    expected = knee.run(*SERIES).tobytes()
    before = len(kernel._READY)
    frozen = [column.copy() for column in SERIES]
    for column in frozen:
        column.flags.writeable = False
    strided = [np.stack([column, column], axis=1)[:, 0] for column in SERIES]
    singles = [column.tolist() for column in SERIES]
    for given in (frozen, strided, singles):
        assert knee.run(*given).tobytes() == expected
    assert len(kernel._READY) == before


@KEPT
def test_what_was_compiled_counts_as_kept() -> None:
    knee = model(compiled=True)
    knee.run(*SERIES)
    assert kernel.is_kept(knee.scene)
    assert kernel.is_kept(knee.scene, only_on_disk=True)


@pytest.mark.xdist_group("tiny kernel")
def test_compiling_is_told_once_in_a_line_and_loading_is_not(tmp_path: Path) -> None:
    def said(home: Path) -> list[str]:
        return use_all(home, [1.0, 1, 1.0], announce=announcement(COSTS[0])).said

    line = "knee_contact_ros: compiling for this kind of knee, once (some 15 s)"
    assert said(tmp_path / "home") == [line, line]  # a float and an integer are two kernels
    assert said(tmp_path / "home") == []
    (tmp_path / "file").touch()
    lines = said(tmp_path / "file" / "home")  # nothing can be kept there
    assert [line for line in lines if line.endswith("what was compiled is not kept")] == []
    assert json.dumps(lines).count("cannot be read: Not a directory") == 2


WITHOUT_NUMBA = """
import sys
sys.modules["numba"] = None
import numpy as np
import knee_contact_ros

time = np.arange(0.0, 0.3, 0.005)
series = (time, 0.4 + 0.3 * np.sin(7.0 * time), 900.0 + 600.0 * np.sin(13.0 * time))
model = knee_contact_ros.load_model({"tibia.geometry": sys.argv[1]}, compiled=True)
print(model.run(*series).tobytes().hex())
stream = knee_contact_ros.load_model({"tibia.geometry": sys.argv[1]}).stream()
print(stream.tick(0.0, 0.4, 900.0).tobytes().hex())
"""


@pytest.mark.parametrize("tibia", ["circle", "plane"])
def test_without_numba_all_goes_on(tibia: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Uncompiled, with one warning; or by the kernel that comes with the package."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))  # what is kept needs no Numba
    done = subprocess.run([sys.executable, "-c", WITHOUT_NUMBA, tibia], capture_output=True, text=True, check=True)
    answers = [bytes.fromhex(line) for line in done.stdout.splitlines()]
    expected = model(compiled=False, **{"tibia.geometry": tibia}).run(*SERIES)
    assert answers == [expected.tobytes(), expected[:1].tobytes()]
    if tibia == "plane":
        assert done.stderr == ""
        assert list(tmp_path.rglob("*.kernel"))
    else:
        (warning,) = done.stderr.splitlines()
        assert warning.startswith("knee_contact_ros: Numba cannot be used (ModuleNotFoundError: ")
