"""Knees as C: no warning, the same numbers on each processor, and refusals as in Python."""

import re
import shutil
import subprocess
from importlib.util import find_spec
from pathlib import Path

import pytest

from knee_contact_ros.commands.main import main
from knee_contact_ros.lab.export import export
from knee_contact_ros.model.compiler import ENTRY, TARGETS, object_code
from knee_contact_ros.model.kernel import portable_code
from knee_contact_ros.parameters.files import load_parameters
from tests import ROOT

pytestmark = [
    pytest.mark.xdist_group("export"),  # one process translates the model
    pytest.mark.skipif(find_spec("numba") is None, reason="needs the extra compile"),
    pytest.mark.skipif(not shutil.which("cc"), reason="needs Debian: apt install gcc)"),
]
WARNINGS = ["-Wall", "-Wextra", "-Wpedantic", "-Werror", "-O2"]
KNEES = {
    "healthy": ["healthy"],
    "osteoarthritis": ["osteoarthritis"],
    "as_printed": ["osteoarthritis_as_printed"],
    "mri_knee": ["healthy", "mri_knee"],
    "gonthier": ["healthy", {"contact.law": "gonthier"}],
}
MICROCONTROLLER = ROOT / "examples" / "microcontroller"
TIME_LIMIT = 120
"""Time [s] after which an emulated processor stands still: a fault of it loops"""


@pytest.fixture(scope="module")
def exported(tmp_path_factory):
    """Function that returns the folder of a knee for a target."""
    folder = tmp_path_factory.mktemp("exported")

    def exported(knee, target):
        output = folder / target / knee
        if not output.exists():
            export(load_parameters(KNEES[knee]), knee, output, target)
        return output

    return exported


def compiled(folder, *arguments, compiler="cc", name="program"):
    """Compile C in a folder; return what the compiler says, which is nothing if it is well."""
    command = [*compiler.split(), *arguments, "-o", name, "-lm"]
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)
    return done.stderr + "failed" * (done.returncode != 0)


def ran(folder, *command):
    """Run a program of a folder; return its exit code and what it prints."""
    done = subprocess.run(
        command or ["./program"],
        cwd=folder,
        capture_output=True,
        text=True,
        timeout=TIME_LIMIT,
        check=False,
    )
    return done.returncode, done.stdout


@pytest.mark.parametrize("knee", KNEES)
def test_a_knee_in_c_gives_the_same_bytes_here(exported, knee):
    folder = exported(knee, "x86-64")
    sources = f"{knee}_test.c", f"{knee}.c", "knee_contact.o"
    assert compiled(folder, "-std=c99", *WARNINGS, *sources) == ""
    code, said = ran(folder)
    assert (code, said) == (
        0,
        f"{knee}: 200 of 200 ticks have the same bytes, the others are at most 0.0e+00 off\n",
    )


def test_the_header_is_c_and_cplusplus(exported):
    folder = exported("healthy", "x86-64")
    shutil.copy(Path(__file__).with_name("refused_samples.cpp"), folder)
    objects = "refused_samples.cpp", "healthy.o", "knee_contact.o"
    subprocess.run(["cc", "-c", "healthy.c"], cwd=folder, check=True)  # noqa: S607
    assert compiled(folder, "-std=c++17", *WARNINGS, *objects, compiler="c++", name="use") == ""
    assert ran(folder, "./use") == (0, "refused 8 of 8, state kept, answers cleared; then 0\n")


BROKEN = {
    "a field that moved": ("    double gap; ", "    double moved; double gap; "),
    "a field that is missing": ("    double load; ", "    /* */ "),
    "a type that is shorter": ("    double femoral_height; ", "    float femoral_height; "),
}


@pytest.mark.parametrize("kind", BROKEN)
def test_a_broken_layout_fails_the_exported_test(exported, tmp_path, kind):
    folder = shutil.copytree(exported("healthy", "x86-64"), tmp_path / "broken")
    header = (folder / "knee_contact.h").read_text()
    before, after = BROKEN[kind]
    assert header.count(before) == 1
    (folder / "knee_contact.h").write_text(header.replace(before, after))
    assert compiled(folder, "-std=c99", "healthy_test.c", "healthy.c", "knee_contact.o")


def test_wrong_constants_fail_the_exported_test(exported, tmp_path):
    """As those of a kernel with another layout of the knee, or of another float ABI, would be."""
    folder = shutil.copytree(exported("healthy", "x86-64"), tmp_path / "wrong")
    source = (folder / "healthy.c").read_text()
    (folder / "healthy.c").write_text(
        source.replace("double mass;\n    double per_mass;", "double per_mass;\n    double mass;")
    )
    assert compiled(folder, "-std=c99", "healthy_test.c", "healthy.c", "knee_contact.o") == ""
    assert ran(folder)[0] == 0
    (folder / "healthy.c").write_text(source.replace("double mass;", "double mass, shift;"))
    assert compiled(folder, "-std=c99", "healthy_test.c", "healthy.c", "knee_contact.o") == ""
    code, said = ran(folder)
    assert code == 1
    assert said.startswith("tick ")


INSTRUCTIONS = {"healthy": 1_293_000, "mri_knee": 7_143_000}
"""Instructions of the exported test's 200 ticks, with those of libm; counted, so that a change that costs more fails"""


@pytest.mark.skipif(not shutil.which("valgrind"), reason="needs Debian: apt install valgrind")
@pytest.mark.parametrize("knee", INSTRUCTIONS)
def test_ticks_take_no_more_instructions(exported, knee):
    folder = exported(knee, "x86-64")
    assert compiled(folder, "-O2", f"{knee}_test.c", f"{knee}.c", "knee_contact.o") == ""
    count = ["--tool=callgrind", f"--toggle-collect={ENTRY}", "--callgrind-out-file=/dev/null"]
    done = subprocess.run(
        ["valgrind", *count, "./program"],  # noqa: S607
        cwd=folder,
        capture_output=True,
        text=True,
        timeout=TIME_LIMIT,
        check=True,
    )
    (counted,) = re.findall(r"Collected : (\d+)", done.stderr)
    assert 0.5 * INSTRUCTIONS[knee] < int(counted) <= 1.05 * INSTRUCTIONS[knee]


@pytest.mark.parametrize("knee", ["healthy", "mri_knee"])
def test_the_same_bytes_on_aarch64(exported, knee):
    compiler, emulator = "aarch64-linux-gnu-gcc", "qemu-aarch64"
    if not (shutil.which(compiler) and shutil.which(emulator)):
        pytest.skip(
            "needs Debian: apt install qemu-user gcc-aarch64-linux-gnu libc6-dev-arm64-cross)"
        )
    folder = exported(knee, "aarch64")
    sources = f"{knee}_test.c", f"{knee}.c", "knee_contact.o"
    assert compiled(folder, "-std=c99", *WARNINGS, *sources, compiler=compiler) == ""
    code, said = ran(folder, emulator, "-L", "/usr/aarch64-linux-gnu", "./program")
    assert (code, "200 of 200" in said) == (0, True), said


def test_an_object_of_another_float_abi_is_not_linked(exported, tmp_path):
    """As the one that LLVM makes for a triple that is not normalised."""
    if not shutil.which("arm-none-eabi-gcc"):
        pytest.skip("needs Debian: apt install gcc-arm-none-eabi libnewlib-arm-none-eabi")
    folder = shutil.copytree(exported("healthy", "cortex-m7"), tmp_path / "soft")
    target = TARGETS["cortex-m7"]._replace(triple="thumbv7em-none-eabihf")
    (folder / "knee_contact.o").write_bytes(object_code(portable_code(), target))
    done = subprocess.run(
        [MICROCONTROLLER / "build.sh", folder, "healthy_test.c", "healthy.c"],
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode != 0
    assert "VFP register arguments" in done.stderr


@pytest.mark.parametrize("knee", ["healthy", "mri_knee"])
def test_the_promised_digits_on_a_cortex_m7(exported, knee):
    compiler, emulator = "arm-none-eabi-gcc", "qemu-system-arm"
    if not (shutil.which(compiler) and shutil.which(emulator)):
        pytest.skip(
            "needs Debian: apt install qemu-system-arm gcc-arm-none-eabi libnewlib-arm-none-eabi)"
        )
    folder = exported(knee, "cortex-m7")
    done = subprocess.run(
        [MICROCONTROLLER / "build.sh", folder, f"{knee}_test.c", f"{knee}.c"],
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    code, said = ran(folder, str(MICROCONTROLLER / "emulate.sh"), "program.elf")
    assert (code, said.startswith(f"{knee}: ")) == (0, True), said


def test_the_command_names_its_files(capsys, tmp_path):
    files = ["healthy", "both_compartments", "--output", str(tmp_path), "--name", "knee"]
    assert main(["export", *files]) == 0
    assert "knee_contact.h" in capsys.readouterr().out
    assert {path.name for path in tmp_path.iterdir()} == {
        "README.md",
        "knee_contact.h",
        "knee_contact.o",
        *(f"knee_{side}{end}" for side in ("medial", "lateral") for end in (".c", "_test.c")),
    }
