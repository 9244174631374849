"""Kernels that come with the package: they are those of this model, and give its bits."""

from __future__ import annotations

import logging
import lzma
import platform
import subprocess
import sys
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from llvmlite import binding as llvm

from knee_contact_ros.compiled import keeping, kernel, shipped
from knee_contact_ros.compiled.keeping import model_meaning
from knee_contact_ros.compiled.kernel_folder import DoubtError
from knee_contact_ros.compiled.layout import kind_of
from knee_contact_ros.compiled.machine_code import object_code
from knee_contact_ros.core.model import KneeModel
from knee_contact_ros.parameters.build import load_model
from knee_contact_ros.system.resources import shipped_parameter_files
from scripts.make_kernels import SOURCES

TIME = np.arange(0.0, 1.0, 0.005)
SERIES = (TIME, 0.5 + 0.4 * np.sin(7.0 * TIME), 600.0 + 900.0 * np.sin(13.0 * TIME))  # lifts off, too
FILES = shipped_parameter_files()
KERNELS = sorted(path.name for path in shipped.FOLDER.glob(f"*{shipped.SUFFIX}"))
one_process = pytest.mark.xdist_group("shipped")
"""Of tests that share what they load"""


@cache
def knees() -> dict[str, tuple[Any, KneeModel]]:
    """Parameters of all knees that kernels are shipped for, and their plain models, by the parameters as text."""
    return {str(source): (source, load_model(source, compiled=False)) for source in SOURCES}


@cache
def by_kernel() -> dict[str, tuple[Any, KneeModel]]:
    """One of these knees for every kernel, by the name of that."""
    return {file.name: knee for knee in knees().values() if (file := shipped.file_of(kind_of(knee[1].scene)))}


def compiled(source: Any) -> KneeModel:
    return load_model(source, compiled=True)


@pytest.fixture
def empty_cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A home in which nothing is kept, for a process that knows no kernel."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    monkeypatch.setattr(kernel, "_READY", {})
    return tmp_path


@one_process
@pytest.mark.parametrize("source", SOURCES, ids=str)
def test_every_law_and_shipped_knee_has_a_kernel_of_this_model(source: Any) -> None:
    file = shipped.file_of(kind_of(knees()[str(source)][1].scene))
    assert file is not None
    assert file.is_file(), "the model has changed: `python -m scripts.make_kernels`"


def test_no_kernel_of_another_model_is_left() -> None:
    assert [path.name for path in shipped.FOLDER.iterdir() if model_meaning() not in path.name] == []


@one_process
@pytest.mark.parametrize("name", KERNELS)
def test_it_gives_the_bits_of_the_plain_model(name: str, empty_cache: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delattr(kernel, "_compiled")
    source, knee = by_kernel()[name]
    series = [column[: 40 if "mri_knee" in str(source) else None] for column in SERIES]
    answers = compiled(source).run(*series)
    assert answers.tobytes() == knee.run(*series).tobytes()
    assert len(list(empty_cache.rglob("*.kernel"))) == 1


@pytest.mark.parametrize("content", [b"no archive", lzma.compress(b"no code of LLVM")])
def test_one_that_is_damaged_is_compiled(
    content: bytes, empty_cache: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    knee = load_model(FILES[0], compiled=False)
    kind = kind_of(knee.scene)
    monkeypatch.setattr(shipped, "FOLDER", empty_cache)
    monkeypatch.setattr(kernel, "_compiled", lambda _scene, _kind: "compiled")
    monkeypatch.setattr(keeping, "_warned", set())
    file = shipped.file_of(kind)
    assert file is not None
    file.write_bytes(content)
    with caplog.at_level(logging.WARNING):
        assert kernel.kernel_of(knee.scene, kind) == "compiled"
    (record,) = caplog.records
    assert record.getMessage().endswith("; compiling")


def test_one_of_another_kind_is_not_taken(empty_cache: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    mine, other = (
        shipped.file_of(kind_of(load_model(source, compiled=False).scene)) for source in (FILES[0], FILES[-1])
    )
    assert mine
    assert other
    content = other.read_bytes()
    monkeypatch.setattr(shipped, "FOLDER", empty_cache)
    (empty_cache / mine.name).write_bytes(content)
    with pytest.raises(DoubtError, match="another kind of knee"):
        shipped.bitcode(kind_of(load_model(FILES[0], compiled=False).scene))


WITHOUT_NUMBA = """
import sys
from pathlib import Path
sys.modules["numba"] = None
import knee_contact_ros
from knee_contact_ros.compiled import shipped
shipped.FOLDER = Path(sys.argv[1])
knee = knee_contact_ros.load_model(compiled=True)
print(knee.run([0.0, 0.01], [0.3, 0.4], [700.0, 900.0]).tobytes().hex())
"""


def test_a_damaged_one_without_numba_leaves_the_plain_model(empty_cache: Path) -> None:
    for path in shipped.FOLDER.iterdir():
        (empty_cache / path.name).write_bytes(b"damaged")
    done = subprocess.run(
        [sys.executable, "-c", WITHOUT_NUMBA, str(empty_cache)], capture_output=True, text=True, check=True
    )
    expected = load_model(compiled=False).run([0.0, 0.01], [0.3, 0.4], [700.0, 900.0])
    assert bytes.fromhex(done.stdout) == expected.tobytes()
    (warning,) = done.stderr.splitlines()
    assert warning.startswith("knee_contact_ros: Numba cannot be used")


def test_on_another_kind_of_machine_there_is_none(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(platform, "machine", lambda: "aarch64")
    assert not shipped.is_there(kind_of(load_model(compiled=False).scene))


def test_a_user_without_a_home_has_it_too(monkeypatch: pytest.MonkeyPatch) -> None:
    def no_home() -> Path:
        raise RuntimeError("Could not determine home directory.")

    monkeypatch.delenv("XDG_CACHE_HOME", raising=False)
    monkeypatch.setattr(Path, "home", no_home)
    model_meaning.cache_clear()
    assert shipped.is_there(kind_of(load_model(compiled=False).scene))


def test_code_for_another_kind_of_machine_is_refused() -> None:
    bitcode = shipped.bitcode(kind_of(load_model(FILES[0], compiled=False).scene))
    assert bitcode
    module = llvm.parse_bitcode(bitcode)
    module.triple = "riscv64-unknown-linux-gnu"
    with pytest.raises(RuntimeError, match="it is for riscv64"):
        object_code(module.as_bitcode())
