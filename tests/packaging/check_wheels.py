"""Wheels for all systems: `make test-package`.

Those of Linux are run, of aarch64 its library under an emulator, and so is the library for Windows where Wine is. Into
those for macOS this only looks: they were not run.
"""

import base64
import hashlib
import os
import re
import shutil
import subprocess
from pathlib import Path
from typing import Any
from zipfile import ZipFile

import pytest

from knee_contact_ros.lab.export import export
from knee_contact_ros.model.compiler import ENTRY, TARGETS, linker
from knee_contact_ros.model.kernel import digest_of_sources
from knee_contact_ros.parameters.files import load_parameters
from scripts.make_wheels import TAGS, make_wheels
from tests.packaging.check_distributions import PACKAGE, UV, environment_with, run

for needed in ("numba", "ziglang", "lief"):
    pytest.importorskip(needed, reason="needs dependency group dev")

LIBM = {"ceil", "exp", "floor", "fmod", "log", "pow", "sincos"}
"""What the library takes from a system; LLVM may leave out some"""
FORMATS = {
    "x86-64": ("ELF", "X86_64", {"libm.so.6"}),
    "aarch64": ("ELF", "AARCH64", {"libm.so.6"}),
    "macos-arm64": ("MACHO", "ARM64", {"@rpath/kernel.dylib", "/usr/lib/libSystem.B.dylib"}),
    "macos-x86-64": ("MACHO", "X86_64", {"@rpath/kernel.dylib", "/usr/lib/libSystem.B.dylib"}),
    "windows-x86-64": ("PE", "AMD64", {"KERNEL32.dll"}),
}
"""Format, processor, and libraries that are loaded; on Windows also those of the C run-time, a part of it since 10"""
WINDOWS_RUN_TIME = re.compile(r"api-ms-win-crt-\w+-l1-1-0\.dll")


@pytest.fixture(scope="module")
def wheels(tmp_path_factory):
    """All wheels by target; the one without a library as `plain`."""
    return dict(zip(["plain", *TAGS], make_wheels(tmp_path_factory.mktemp("wheels")), strict=True))


def library_in(wheel, folder):
    """Return the library of a wheel, unpacked."""
    with ZipFile(wheel) as archive:
        (name,) = (each for each in archive.namelist() if "/model/knee_contact-" in each)
        return Path(archive.extract(name, folder))


@pytest.mark.parametrize("target", ["plain", *TAGS])
def test_a_wheel_lists_its_files_and_names_its_platform(wheels, target):
    tag = TAGS.get(target, "any")
    assert wheels[target].name.endswith(f"-py3-none-{tag}.whl")
    with ZipFile(wheels[target]) as archive:
        (record,) = (name for name in archive.namelist() if name.endswith("RECORD"))
        listed = dict(line.split(",", 1) for line in archive.read(record).decode().splitlines())
        assert set(listed) == set(archive.namelist())
        for name, found in listed.items():
            content = archive.read(name)
            digest = base64.urlsafe_b64encode(hashlib.sha256(content).digest()).rstrip(b"=")
            assert found == ("," if name == record else f"sha256={digest.decode()},{len(content)}")
        about = archive.read(record.replace("RECORD", "WHEEL")).decode()
        libraries = [name for name in listed if name.startswith(f"{PACKAGE}/model/knee_contact-")]
    assert f"Tag: py3-none-{tag}\n" in about
    assert f"Root-Is-Purelib: {str(target == 'plain').lower()}\n" in about
    suffix = TARGETS[target].suffix if target in TARGETS else ""
    name = f"{PACKAGE}/model/knee_contact-{digest_of_sources()}{suffix}"
    assert libraries == ([] if target == "plain" else [name])


def loaded(binary):
    """Names of the libraries that a library loads."""
    return {each if isinstance(each, str) else each.name for each in binary.libraries}


@pytest.mark.parametrize("target", TAGS)
def test_a_library_is_of_its_platform_and_needs_its_libm_alone(wheels, tmp_path, target):
    import lief

    binary: Any = lief.parse(str(library_in(wheels[target], tmp_path)))
    head = binary.header
    format_, processor, libraries = FORMATS[target]
    kind = {"ELF": "machine_type", "MACHO": "cpu_type", "PE": "machine"}[format_]
    assert (binary.format.name, getattr(head, kind).name) == (format_, processor)
    assert ENTRY in {each.name.removeprefix("_") for each in binary.exported_functions}
    extra = loaded(binary) - libraries
    taken = {each.name for each in binary.imported_functions}
    if format_ == "PE":  # Zig's start of a library takes more; its mathematics is within
        assert all(map(WINDOWS_RUN_TIME.fullmatch, extra))
    elif format_ == "ELF":
        assert (extra, taken - LIBM) == (set(), set())
        versions = {
            each.name
            for one in binary.symbols_version_requirement
            for each in one.get_auxiliary_symbols()
        }
        most = max(tuple(map(int, each.removeprefix("GLIBC_").split("."))) for each in versions)
        assert most <= tuple(map(int, TAGS[target].split("_")[1:3]))
    else:
        names = {each.strip("_").removesuffix("_stret") for each in taken}
        assert (extra, names - LIBM - {"dyld_stub_binder"}) == (set(), set())
        assert list(binary.build_version.minos)[:2] == [11, 0]
        if (
            processor == "ARM64"
        ):  # macOS loads nothing there that is not signed, if only by its linker
            assert binary.has_code_signature
    assert str(Path.home()).encode() not in Path(library_in(wheels[target], tmp_path)).read_bytes()


@pytest.mark.parametrize("target", ["x86-64", "plain"])
def test_a_wheel_solves_in_an_environment_without_ros_and_numba(wheels, tmp_path, target):
    """To the bytes of the tree; the plain one says once that it is slow."""
    programs = environment_with(str(wheels[target]), tmp_path)
    listed = run(UV, "pip", "list", "--python", programs / "python", folder=tmp_path)
    assert not re.search("^(ros-|numba|llvmlite|ziglang)", listed, re.MULTILINE)
    bag = programs.parent / "share" / PACKAGE / "bags" / "gait2354_right"
    solved = {}
    for place in (programs, UV.parent):
        folder = tmp_path / place.parent.name
        folder.mkdir(exist_ok=True)
        done = subprocess.run(
            [place / "knee-contact", "solve", bag, "--output", "solved.mcap"],
            cwd=folder,
            env={**os.environ, "XDG_CACHE_HOME": str(tmp_path / "cache")},
            capture_output=True,
            text=True,
            check=True,
        )
        recording = (folder / "solved.mcap").read_bytes()
        solved[place] = recording, done.stderr.count("there is no compiled model")
    assert solved[programs][0] == solved[UV.parent][0]
    assert solved[programs][1] == (target == "plain")


EMULATED = {
    "x86-64": ["cc"],
    "aarch64": ["aarch64-linux-gnu-gcc"],
    "windows-x86-64": linker(TARGETS["windows-x86-64"]),
}
EMULATORS = {
    "x86-64": [],
    "aarch64": ["qemu-aarch64", "-L", "/usr/aarch64-linux-gnu"],
    "windows-x86-64": ["wine"],
}


@pytest.mark.parametrize("target", EMULATED)
def test_the_library_of_a_wheel_gives_the_promised_digits(wheels, tmp_path, target):
    """The exported test calls the library instead of the exported object; by Linux's libm to the same bytes."""
    if missing := [
        one[0] for one in (EMULATED[target], EMULATORS[target]) if one and not shutil.which(one[0])
    ]:
        pytest.skip(
            f"{missing[0]} is not there (Debian: apt install qemu-user gcc-aarch64-linux-gnu wine)"
        )
    export(load_parameters(["healthy"]), "healthy", tmp_path, "x86-64")
    # Windows looks for it under the name that it was linked with.
    library = tmp_path / f"made{TARGETS[target].suffix}"
    shutil.copy(library_in(wheels[target], tmp_path), library)
    sources = ["healthy_test.c", "healthy.c", library.name, "-Wl,-rpath,$ORIGIN", "-lm"]
    run(*EMULATED[target], "-std=c99", "-o", "program.exe", *sources, folder=tmp_path)
    told = run(*EMULATORS[target], "./program.exe", folder=tmp_path)
    assert told.startswith("healthy: ")
    assert "200 of 200" in told or target.startswith("windows")
