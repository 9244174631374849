"""What is compiled gives the same bits, and what is kept can only help: a tiny model, in processes of its own."""

from __future__ import annotations

import logging
import math
import multiprocessing
import os
import sys
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import numba
import pytest

CONSTANT = "FACTOR = 3.0\n"
TOY = """
import math
from typing import NamedTuple
from constants import FACTOR
from knee_contact_ros.model.compiler import in_kernel

class Pair(NamedTuple):
    a: float
    b: float

@in_kernel
def wave(pair: Pair, x: float) -> Pair:
    return Pair(math.exp(-pair.a * x) * math.sin(pair.b), pair.b / (x + FACTOR))

@in_kernel
def run(knee: Pair, values, answers) -> None:
    pair = Pair(knee.a, knee.b)
    for i in range(len(values)):
        pair = wave(pair, values[i])
        answers[i] = pair.a + pair.b
"""
USE = """
import numpy as np
import toy
from knee_contact_ros.model import compiler
values, answers, plain = np.linspace(0.1, 9.7, 40), np.zeros(40), np.zeros(40)
knee = toy.Pair(0.7, 2.9)
toy.run(knee, values, plain)
run = compiler.compiled(toy.run, (knee, values, answers)) or toy.run
run(knee, values, answers)
assert answers.tobytes() == plain.tobytes()
print(answers[-1])
"""
COMPILES = "knee_contact_ros: compiling the model, once"


class Outcome(NamedTuple):
    """What a process has seen."""

    answer: str
    compiled: bool
    """Whether it has compiled, or else loaded"""
    warnings: list[str]


class Folders:
    """A toy model beside a user's home; `package` and `cache` are where it can be kept."""

    def __init__(self, root: Path) -> None:
        self.model, self.home = root / "model", root / "home"
        self.package = self.model / "__pycache__" / "compiled"
        self.cache = self.home / ".cache" / "knee_contact_ros"
        self.model.mkdir()
        self.home.mkdir()
        (self.model / "constants.py").write_text(CONSTANT)
        (self.model / "toy.py").write_text(TOY)

    def use(self, begin: str = "", **environment: str) -> Outcome:
        """Compute by the toy model in a process of its own, which compares it with the plain one.

        It is forked, as importing Numba takes longer than compiling the toy.
        """
        log = self.home / "log"
        code = multiprocessing.get_context("fork").Process(
            target=use, args=(self, begin + USE, environment, log)
        )
        code.start()
        code.join()
        said = log.read_text().splitlines()
        assert code.exitcode == 0, said
        answer = said.pop()
        warnings = [line for line in said if not line.startswith(COMPILES)]
        return Outcome(answer, len(warnings) < len(said), warnings)

    def kept(self) -> list[Path]:
        """All files, complete or not."""
        return [
            path
            for folder in (self.package, self.cache)
            if folder.is_dir()
            for path in folder.iterdir()
        ]


def use(folders: Folders, program: str, environment: dict[str, str], log: Path) -> None:
    """In a process of its own: run a program; what it says goes to a file."""
    sys.stdout = sys.stderr = log.open("w", buffering=1)
    logging.basicConfig(format="%(message)s", stream=sys.stderr, force=True)
    os.environ.pop("XDG_CACHE_HOME", None)
    os.environ.update(environment, HOME=str(folders.home))
    sys.path.insert(0, str(folders.model))
    exec(program, {})  # noqa: S102


@pytest.fixture(scope="module")
def warm() -> None:
    """Have Numba compile something here, so that no forked process must set it up."""
    numba.njit(lambda x: math.exp(x) * math.sin(x))(1.0)


@pytest.fixture
def folders(tmp_path: Path, warm: None) -> Folders:
    return Folders(tmp_path)


def test_it_is_compiled_once_and_again_when_any_source_beside_it_changes(folders: Folders) -> None:
    first = folders.use()
    assert first.compiled
    assert not first.warnings
    (path,) = folders.kept()
    assert path.parent == folders.package
    assert folders.use() == first._replace(compiled=False)
    (folders.model / "constants.py").write_text(CONSTANT.replace("3.0", "5.0"))
    changed = folders.use()
    assert changed.compiled
    assert changed.answer != first.answer
    assert path in folders.kept()


def damage(path: Path) -> None:
    data = bytearray(path.read_bytes())
    data[-100] ^= 1
    path.write_bytes(data)


HARMS: list[Callable[[Path], object]] = [
    damage,
    lambda path: path.write_bytes(path.read_bytes()[:1000]),
    lambda path: path.chmod(0o666),
    lambda path: path.symlink_to(path.rename(path.parents[3] / "home" / "elsewhere")),
    *[lambda path: os.chown(path, 12345, 12345)] * (os.geteuid() == 0),  # who is not root cannot
]
"""Damage, a part, a file that others can write, a link, and one that belongs to another user"""


def test_a_file_that_cannot_be_trusted_costs_one_warning(folders: Folders) -> None:
    whole = folders.use()
    for number, harm in enumerate(HARMS):
        harm(folders.kept()[0])
        again = folders.use()
        assert (again.answer, again.compiled) == (whole.answer, True), number
        (line,) = again.warnings
        assert line.startswith(f"knee_contact_ros: compiled code: {folders.package}")
        assert line.endswith("; compiled again")
    assert folders.use() == whole._replace(compiled=False)


def test_a_folder_that_others_can_write_is_left_for_the_users_own(folders: Folders) -> None:
    folders.package.mkdir(parents=True)
    folders.package.chmod(0o777)
    whole = folders.use()
    assert not whole.warnings
    (path,) = folders.kept()
    assert path.parent == folders.cache
    assert folders.use() == whole._replace(compiled=False)
    os.link(path, folders.package / path.name)
    assert folders.use() == whole._replace(compiled=False)  # of the other one nobody need know
    path.unlink()
    assert "others can write it" in folders.use().warnings[0]


def test_without_a_place_it_is_compiled_for_the_process(folders: Folders) -> None:
    folders.package.parent.write_text("no folder")
    nowhere = folders.use(XDG_CACHE_HOME="/dev/null")
    assert nowhere.compiled
    (line,) = nowhere.warnings
    assert line.endswith("; what was compiled is not kept")
    no_home = folders.use(
        "import os, pwd; del os.environ['HOME']; pwd.getpwuid = lambda _: {}['nobody']\n"
    )
    assert (no_home.answer, no_home.compiled, len(no_home.warnings)) == (nowhere.answer, True, 1)


def test_on_a_full_disk_no_part_of_a_file_stays(folders: Folders) -> None:
    full = "import resource, sys; resource.setrlimit(resource.RLIMIT_FSIZE, (1000, 1000))\n"
    (line,) = folders.use(full).warnings
    assert "File too large; what was compiled is not kept" in line
    assert folders.kept() == []


@pytest.mark.parametrize(
    "begin",
    [
        "import sys; sys.modules['numba'] = None\n",
        "import numba; numba.config.DISABLE_JIT = 1\n",
    ],
)
def test_without_numba_one_line_says_so(begin: str, folders: Folders) -> None:
    outcome = folders.use(begin)
    assert not outcome.compiled
    (line,) = outcome.warnings
    assert line.startswith("knee_contact_ros: Numba cannot be used (")
