"""The library of the model: the same bits as plain Python, built once, portable, and missed with one line."""

import os
import pickle
import shutil
import subprocess
import sys
import threading
from dataclasses import replace
from functools import cache
from importlib.util import find_spec

import pytest

pytest.importorskip("tabulate", reason="the studies' tables")

from knee_contact_ros import load_model
from knee_contact_ros.model import compiler, kernel
from knee_contact_ros.model.compiler import (
    ENTRY,
    FAST_ENTRY,
    TARGETS,
    BuildError,
    host,
    object_code,
)
from knee_contact_ros.model.kernel import found_library, library_file
from knee_contact_ros.model.laws import CONTACT_LAWS
from studies.honesty import ours
from studies.honesty.scenes import draw
from tests.helpers.package import WITHOUT_LIBRARY, copy_of_the_package
from tests.helpers.scenes import law, model
from tests.model.scenes import PAIRS, hopping, stepping

LIBM = {"ceil", "cos", "exp", "floor", "fmod", "log", "pow", "sin", "sincos", "sqrt", "trunc"}
"""All that a library may need from elsewhere"""
USE = """
import knee_contact_ros
print(knee_contact_ros.load_model().run([0.0, 0.01], [0.3, 0.31], [700.0, 710.0]).penetration_depth[-1])
"""
needs_numba = pytest.mark.skipif(find_spec("numba") is None, reason="needs the extra compile")


@pytest.mark.parametrize("level", ["dynamic", "quasi_static"])
@pytest.mark.parametrize("name", CONTACT_LAWS)
def test_the_library_gives_the_bits_of_plain_python(name, level):
    """Each law, on one pair of surfaces after the other, with lift-offs and jumps of the load."""
    pairs = list(PAIRS.values())
    pair = pairs[list(CONTACT_LAWS).index(name) % len(pairs)]()
    for time, angle, load in (hopping(40), stepping(40)):
        plain = model(law(name), 1e-6, pair=pair, budget=2000)
        plain = replace(plain, level={"dynamic": plain.level, "quasi_static": 0}[level])
        fast = replace(plain, compiled=True)
        assert plain.run(time, angle, load).tobytes() == fast.run(time, angle, load).tobytes()


@pytest.mark.parametrize("level", ["dynamic", "quasi_static"])
def test_200_random_scenes_have_the_bits_of_plain_python(level):
    """All laws, with extreme constants, of which one tick in a few reaches the budget."""
    for seed in range(200):
        scene = draw(seed)
        knee = ours.knee(scene, level, 1e-6, budget=100)
        motion = [column[:6] for column in (scene.time, scene.angle, scene.load)]
        answers = [replace(knee, compiled=one).run(*motion).tobytes() for one in (True, False)]
        assert answers[0] == answers[1], seed


def test_both_copies_of_the_library_give_the_same_bits(monkeypatch):
    """That for older processors, and that for newer ones."""
    if not kernel.has_fast_processor():
        pytest.skip("needs a processor of x86-64-v3 and Linux")
    knees = [model(law("gonthier"), pair=pair()) for pair in PAIRS.values()]
    runs = []
    for fast in (True, False):
        monkeypatch.setattr(kernel, "has_fast_processor", lambda fast=fast: fast)
        monkeypatch.setattr(kernel, "library", cache(kernel.library.__wrapped__))
        runs.append(
            [replace(knee, compiled=True).run(*hopping(300, 2e-3)).tobytes() for knee in knees]
        )
    assert runs[0] == runs[1]


def test_a_model_that_has_run_can_be_sent_to_another_process():
    knee = load_model(compiled=True)
    answers = [one.run(*hopping(9)).tobytes() for one in (knee, pickle.loads(pickle.dumps(knee)))]  # noqa: S301
    assert answers[0] == answers[1]


def test_any_number_of_threads_may_run_knees():
    time, angle, load = hopping(2000, 1e-3)
    knees = [load_model(name, compiled=True) for name in ("healthy", "osteoarthritis")] * 2
    alone = [knee.run(time, angle, load).tobytes() for knee in knees]
    together: dict[int, bytes] = {}

    def run(number):
        together[number] = knees[number].run(time, angle, load).tobytes()

    threads = [threading.Thread(target=run, args=(number,)) for number in range(len(knees))]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert [together[number] for number in range(len(knees))] == alone


def used(folder, begin="", **environment):
    """Return what a use of a copy prints, and what it says on stderr."""
    own = {**os.environ, "PYTHONPATH": str(folder), "HOME": str(folder / "home"), **environment}
    own.pop("XDG_CACHE_HOME", None)
    done = subprocess.run(
        [sys.executable, "-c", begin + USE],
        cwd=folder,
        env=own,
        capture_output=True,
        text=True,
        check=True,
    )
    return done.stdout, done.stderr


@needs_numba
def test_an_edit_of_the_model_builds_it_again_once(tmp_path):
    package = copy_of_the_package(tmp_path)
    as_built = used(tmp_path)
    assert as_built[1] == ""
    laws = package / "model" / "laws.py"
    edited = laws.read_text("utf-8").replace(
        "return ContactLaw((Layer(stiffness=stiffness",
        "return ContactLaw((Layer(stiffness=2.0 * stiffness",
    )
    laws.write_text(edited + "\n# Another law\n", "utf-8")
    depth, said = used(tmp_path)
    assert said.startswith("knee_contact_ros: building the compiled model, once")
    assert len(said.splitlines()) == 1
    assert float(depth) < float(as_built[0])
    assert used(tmp_path) == (depth, "")


def test_without_library_and_numba_the_plain_model_computes_and_says_so_once(
    tmp_path,
):
    copy = copy_of_the_package(tmp_path, WITHOUT_LIBRARY)
    with (copy / "model" / "__init__.py").open("a") as sources:
        sources.write("# The library of an installed package belongs to others.\n")
    (tmp_path / "numba.py").write_text("raise ImportError('not here')")
    hidden = "import importlib.util as u; find = u.find_spec\n"
    hidden += "u.find_spec = lambda name, *rest: None if name == 'numba' else find(name, *rest)\n"
    depth, said = used(tmp_path, hidden)
    assert depth == used_here()
    (line,) = said.splitlines()
    assert (
        "there is no compiled model (Numba is not installed); the plain one computes, slowly"
        in line
    )


def used_here():
    """Return what a use of this package prints."""
    return f"{load_model().run([0.0, 0.01], [0.3, 0.31], [700.0, 710.0]).penetration_depth[-1]}\n"


@pytest.mark.skipif(not shutil.which("nm"), reason="needs binutils (Debian: apt install binutils)")
def test_the_library_needs_libm_alone_and_holds_no_data():
    assert found_library()
    listed = subprocess.run(
        ["nm", "-D", library_file()],  # noqa: S607
        capture_output=True,
        text=True,
        check=True,
    )
    symbols = [line.split()[-2:] for line in listed.stdout.splitlines()]
    needed = {name.split("@")[0] for kind, name in symbols if kind == "U"}
    assert needed <= LIBM
    assert [name for kind, name in symbols if kind in "TDB"] == (
        [ENTRY, FAST_ENTRY] if host().fast_cpu else [ENTRY]
    )


@needs_numba
def test_code_with_sizes_or_names_of_this_machine_is_refused(
    monkeypatch,
):
    address = "define i32 @kernel() { %a = inttoptr i64 4096 to ptr\n %b = load i32, ptr %a\n ret i32 %b }"
    outside = "declare i32 @numba_helper()\ndefine i32 @kernel() { %b = call i32 @numba_helper()\n ret i32 %b }"
    monkeypatch.setattr(
        compiler,
        "_entry_code",
        lambda _entry: (
            "declare i32 @kernel()\ndefine i32 @knee_contact_run() { %c = call i32 @kernel()\n ret i32 %c }"
        ),
    )
    for code in (address, outside):
        with pytest.raises(BuildError, match="the object needs"):
            object_code(code, TARGETS["cortex-m7"])
    for piece in (
        "getelementptr inbounds i8, ptr %knee, i64 24",
        "call void @llvm.memcpy.p0(ptr %a, ptr %b, i64 32, i1 false)",
    ):
        assert compiler.HOST_SIZES.search(piece)


@needs_numba
def test_what_is_changed_in_numba_is_still_there():
    """Names that are not public, by which the model is translated in 5 s instead of 40 s."""
    from numba import njit
    from numba.core.codegen import CPUCodeLibrary, JITCodeLibrary
    from numba.core.typeinfer import TypeVar
    from numba.core.types.functions import BaseFunction

    assert isinstance(njit(lambda x: x).targetctx.codegen()._library_class, type)
    assert {"add_llvm_module", "finalize"} <= set(dir(CPUCodeLibrary))
    assert "get_pointer_to_function" in dir(JITCodeLibrary)
    assert {"add_type", "lock"} <= set(dir(TypeVar))
    assert callable(BaseFunction.get_call_type)
