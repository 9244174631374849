"""The model of a knee as C: what `knee-contact export` writes for a controller or a microcontroller."""

import math
import re
from collections.abc import Mapping, Sequence
from functools import cache
from importlib.resources import files
from pathlib import Path
from string import Template
from typing import Any

import numpy as np

from ... import __version__
from ...model.compiler import (
    TARGETS,
    BuildError,
    object_code,
)
from ...model.kernel import portable_code
from ...model.knee import LARGEST_ANGLE, LARGEST_LOAD, LARGEST_TIME, KneeModel
from ...model.run_state import AT_BEGUN, STATE_SIZE
from ...model.types import (
    FIELDS,
    FLAT,
    ROW,
    UNUSABLE,
    ContactState,
    Floats,
    Rows,
    Status,
    blank_answers,
)
from ...parameters.build import build_model
from ...parameters.curves import curve_texts, lateral_texts
from ...parameters.schema import Parameters, has_two_compartments, lateral_knee
from ...system.errors import UsageError

COMPILERS = {
    "x86-64": ("cc", "./{name}_test"),
    "aarch64": (
        "aarch64-linux-gnu-gcc",
        "./{name}_test    # or qemu-aarch64 -L /usr/aarch64-linux-gnu",
    ),
    "cortex-m7": (
        "arm-none-eabi-gcc -mcpu=cortex-m7 -mthumb -mfloat-abi=hard -mfpu=fpv5-d16 --specs=rdimon.specs",
        "# link it with the start-up code of your board, and run it there",
    ),
}
"""C compiler of each target, and how the test is run"""
TYPES = {"f8": "double", "i8": "int64_t", "u4": "uint32_t", "u1": "uint8_t"}
"""C's types of NumPy's"""
CODES = ("contact_state", "fidelity", "status")
"""Fields that must be the same on each processor"""
UNCHECKED = ("stamp", "latency", "evaluations")
"""Fields that a tick does not know; and the cost, which differs by a few where a library of C rounds otherwise"""
TICKS = 200
"""Number of ticks of the test: a second at 200 Hz, with five landings"""
ESTIMATED = {"error_estimate": "penetration_depth", "force_error_estimate": "contact_force"}
"""Fields that estimate errors, and of which: their rounding is that of these, of which they are differences"""
PROMISED_DIFFERENCE = 1e-9
"""Promised difference between processors, as a fraction of the largest number of a field, or of what it estimates"""


def export(parameters: Parameters, name: str, output: Path, target: str) -> list[Path]:
    """Write the model of a knee for a target: header, object, constants, test and a page that says how to use them.

    Args:
        parameters: Parameters of the knee; with both compartments each becomes a knee of its own.
        name: Name of the knee in C.
        output: Folder, which is made.
        target: Name in `COMPILERS`.

    Returns:
        The files.

    Raises:
        UsageError: the knee cannot be exported, Numba is missing, or a file cannot be written.
    """
    if not re.fullmatch(r"[A-Za-z_]\w*", name, re.ASCII):
        raise UsageError(f"name {name!r} is no name in C: use letters, digits and _")
    if parameters.drive != "force":
        raise UsageError(f"drive {parameters.drive} cannot be exported: only the force drive")
    knees = models(parameters, name)
    try:
        kernel = kernel_object(target)
    except BuildError as error:
        raise UsageError(
            f"export needs Numba: pip install 'knee_contact_ros[compile]' ({error})"
        ) from None
    contents: dict[str, bytes] = {
        "knee_contact.h": header_text().encode(),
        "knee_contact.o": kernel,
        "README.md": page(list(knees), target).encode(),
    }
    for knee, model in knees.items():
        contents[f"{knee}.c"] = constants(model.constants, knee).encode()
        contents[f"{knee}_test.c"] = test(model, knee).encode()
    try:
        output.mkdir(parents=True, exist_ok=True)
        for file, content in contents.items():
            (output / file).write_bytes(content)
    except OSError as error:
        raise UsageError(f"cannot write {output}: {error.strerror}") from None
    return [output / file for file in contents]


@cache
def kernel_object(target: str) -> bytes:
    """Return the object of the kernel, which is the same for each knee."""
    return object_code(portable_code(), TARGETS[target])


def models(parameters: Parameters, name: str) -> dict[str, KneeModel]:
    """Return the models of a knee's compartments by their names in C."""
    texts = curve_texts(parameters, {})
    if not has_two_compartments(parameters):
        return {name: build_model(parameters, curves=texts)}
    return {
        f"{name}_medial": build_model(parameters, curves=texts),
        f"{name}_lateral": build_model(lateral_knee(parameters), curves=lateral_texts(texts)),
    }


def fill_template(template: str, **values: object) -> str:
    """Return a file of this folder with its values."""
    text = files(__package__).joinpath(f"{template}.in").read_text("utf-8")
    return Template(text).substitute(version=__version__, answer_bytes=ROW.itemsize, **values)


def header_text() -> str:
    """Return the C interface; an answer has the layout of a row."""
    lines = []
    for name in FLAT.names or ():
        declared = f"    {TYPES[FLAT[name].str[1:]]} {name};"
        lines.append(f"{declared:<46}/* [{FIELDS[name].unit or '1'}] */")
    status = {"OK": 0, **{str(one.name): int(one) for one in Status if one}}
    status["UNUSABLE"] = int(UNUSABLE)
    return fill_template(
        "knee_contact.h",
        fields="\n".join(lines),
        status=_enumeration(status),
        states=_enumeration({one.name: int(one) for one in ContactState}),
        state_size=STATE_SIZE,
        state_bytes=8 * STATE_SIZE,
        begun=AT_BEGUN,
        largest_angle=LARGEST_ANGLE,
        largest_load=LARGEST_LOAD,
        largest_time=LARGEST_TIME,
    )


def _enumeration(values: Mapping[str, int]) -> str:
    return ",\n".join(f"    KNEE_CONTACT_{name} = {value}" for name, value in values.items())


def number(value: float) -> str:
    """Return a number in C, without loss."""
    if math.isnan(value):
        return "NAN"
    if math.isinf(value):
        return "INFINITY" if value > 0.0 else "-INFINITY"
    return float(value).hex()


def constants(knee: Any, name: str) -> str:
    """Return C source with a knee's constants, in the structures that the kernel takes; see `kernel.Constants`."""
    declarations: dict[str, str] = {}
    data: list[str] = []

    def structure(values: Any, variable: str, kind: str) -> None:
        fields, given = [], []
        for field, value in zip(values._fields, values, strict=True):
            inner = f"{variable}_{field}"
            if isinstance(value, np.ndarray):
                item = "int64_t" if value.dtype.kind == "i" else "double"
                numbers = value.ravel().tolist()
                texts = map(str, numbers) if item == "int64_t" else map(number, numbers)
                data.append(f"static const {item} {inner}[] = {{\n{_wrapped(texts) or '0'}}};")
                shape, strides = (_braces(map(str, one)) for one in (value.shape, value.strides))
                given.append(
                    f"{{0, 0, {value.size}, {value.itemsize}, {inner}, {shape}, {strides}}}"
                )
                fields.append(f"struct knee_array_{value.ndim} {field};")
            elif hasattr(value, "_fields"):
                part = f"knee_{type(value).__name__.lower()}"
                structure(value, inner, part)
                given.append(f"&{inner}")
                fields.append(f"const struct {part} *{field};")
            else:
                kinds = {bool: "uint8_t", int: "int64_t", float: "double"}
                given.append(number(value) if isinstance(value, float) else str(int(value)))
                fields.append(f"{kinds[type(value)]} {field};")
        declarations[kind] = (
            f"struct {kind} {{\n" + "".join(f"    {one}\n" for one in fields) + "};"
        )
        static = "" if variable == name else "static "
        data.append(
            f"{static}const struct {kind} {variable} = {{\n    " + ",\n    ".join(given) + "\n};"
        )

    structure(knee, name, "knee_contact_knee")
    arrays = [
        f"struct knee_array_{n} {{\n    const void *owner, *parent;\n    int64_t count, item;\n"
        f"    const void *data;\n    int64_t shape[{n}], strides[{n}];\n}};"
        for n in (1, 2)
    ]
    begin = f'/* Constants of the knee "{name}". Made by `knee-contact export`. */\n#include "knee_contact.h"'
    outside = f"extern const struct knee_contact_knee {name};"
    return "\n\n".join([begin, *arrays, *declarations.values(), outside, *data]) + "\n"


def _braces(texts: Any) -> str:
    return "{" + ", ".join(texts) + "}"


def _wrapped(texts: Any) -> str:
    """Return numbers in lines of four."""
    each = list(texts)
    return ",\n".join(", ".join(each[k : k + 4]) for k in range(0, len(each), 4))


def vector(model: KneeModel) -> tuple[Floats, Rows]:
    """Return the samples of the test, shape (n, 3), and the model's answers: gait-like turns with landings."""
    time = 0.005 * np.arange(TICKS)
    samples = np.column_stack(
        [
            np.full(TICKS, 0.005),
            0.5 + 0.45 * np.sin(6.0 * np.pi * time),
            300.0 + 350.0 * np.sin(10.0 * np.pi * time),
        ]
    )
    answers = blank_answers(TICKS)
    model.compute(np.column_stack([samples, np.full(TICKS, math.nan)]), answers)
    return samples, answers


def test(model: KneeModel, name: str) -> str:
    """Return a C program that computes samples and compares the answers with the model's."""
    samples, rows = vector(model)
    answers = rows.view(FLAT)
    checked = [one for one in FLAT.names or () if one not in (*CODES, *UNCHECKED)]
    scales = [answers[ESTIMATED.get(one, one)] for one in checked]
    largest = [max(float(np.abs(scale).max()), 1e-9) for scale in scales]
    expected = [
        "{"
        + _braces(number(answer[one]) for one in checked)
        + ", "
        + _braces(str(answer[one]) for one in CODES)
        + "}"
        for answer in answers
    ]
    fields = (FLAT.fields or {}).items()
    offsets = [f"AT({one}, {place}, {kind.itemsize});" for one, (kind, place, *_) in fields]
    return fill_template(
        "test.c",
        name=name,
        count=TICKS,
        tolerance=PROMISED_DIFFERENCE,
        offsets="\n".join(offsets),
        samples=",\n".join(_braces(map(number, sample)) for sample in samples.tolist()),
        expected=",\n".join(expected),
        numbers=len(checked),
        codes=len(CODES),
        largest=", ".join(map(number, largest)),
        names=", ".join(f'"{one}"' for one in checked),
        answered=", ".join(f"a.{one}" for one in checked),
        answered_codes=", ".join(f"a.{one}" for one in CODES),
    )


def page(names: Sequence[str], target: str) -> str:
    """Return the page that lists the files and says how they are used."""
    compiler, run = COMPILERS[target]
    rows = [
        f"| `{name}.c`, `{name}_test.c` | constants of a knee, and a test that this processor computes it rightly |"
        for name in names
    ]
    sources = f"{names[0]}_test.c {names[0]}.c knee_contact.o"
    return fill_template(
        "README.md",
        target=target,
        name=names[0],
        files="\n".join(rows),
        compile=f"{compiler} -std=c99 -O2 -o {names[0]}_test {sources} -lm",
        run=run.format(name=names[0]),
    )
