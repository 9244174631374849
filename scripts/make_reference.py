"""Make the pages of the reference that follow from the code: parameters, commands, messages and Python.

    python -m scripts.make_reference

They are kept in the repository, so that a code host shows them; `tests/packaging/test_pages.py` fails if they are old.
"""

from __future__ import annotations

import ast
import importlib
import inspect
import re
import textwrap
from collections.abc import Iterator
from math import inf, isfinite
from pathlib import Path
from typing import Any

import click

from knee_contact_ros.commands.main import GROUPS, knee_contact
from knee_contact_ros.node.contact_node import CONTACT_NODE
from knee_contact_ros.node.load_node import LOAD_NODE
from knee_contact_ros.parameters.files import known_parameters
from knee_contact_ros.parameters.schema import LATERAL_PREFIX
from knee_contact_ros.parameters.sections import Declaration

ROOT = Path(__file__).parents[1]
REFERENCE = ROOT / "docs" / "reference"
MADE = "<!-- made by python -m scripts.make_reference -->"
WIDTH = 100
UNIT = re.compile(r"^\[([^]]+)\] ?")
SECTION = re.compile(r"^(Args|Returns|Raises|Yields):$", re.MULTILINE)
PYTHON = {
    "Functions": [
        "load_model",
        "solve",
        "estimate_load",
        "uncertainty",
        "sweep",
        "sensitivity",
        "calibrate",
        "paired",
        "UsageError",
        "streams.strides.strides_of",
    ],
    "The model": [
        "model.knee.KneeModel: run stream readouts ringing uncertainty plausible_depth cartilage_thickness",
        "model.knee.Stream: tick",
    ],
    "Answers": [
        "Gait: strides cycles",
        "Results: time readouts ringing to_pandas to_polars to_xarray to_parquet plot",
        "model.types.Contact",
        "model.types.Point",
        "model.types.Wrench",
        "model.types.ContactState",
        "model.types.Fidelity",
        "model.types.Status",
        "model.readouts.ContactPatch",
    ],
    "Studies": [
        "lab.uncertainty.Uncertainty",
        "lab.uncertainty.Propagated",
        "lab.sweep.Cohort",
        "lab.sensitivity.Sensitivity: outcomes remarks cohort to_pandas",
        "lab.calibrate.Calibration",
        "lab.calibrate.intervals.Interval",
        "streams.strides.Stride",
        "streams.strides.Span: duration stance percent",
    ],
}
"""Public names within the package, by heading; behind a colon, those members of a class that are public"""


def parameters() -> str:
    """Tables of all parameters of both nodes."""
    lines = [
        "# Parameters",
        "",
        MADE,
        "",
        "A parameter file holds these names under `NODE: ros__parameters:`. A value that is not allowed ends a command",
        "with code 2. *Live*: the parameter may change while the node runs. `femur.*`, `tibia.*` and `contact.*` have",
        "lateral twins such as `lateral.femur.radius`, which follow the medial ones unless you set them.",
    ]
    for kind in (CONTACT_NODE, LOAD_NODE):
        lines += [
            "",
            f"## {kind.schema.node}",
            "",
            "| parameter | meaning | default | range | live |",
            "|---|---|---|---|---|",
        ]
        for name, declaration in known_parameters(kind.schema).items():
            if not name.startswith(LATERAL_PREFIX):
                unit = UNIT.match(declaration.description)
                meaning = UNIT.sub("", declaration.description)
                lines.append(
                    f"| `{name}` | {meaning} | `{shown(declaration.default)}` {unit[1] if unit else ''} "
                    f"| {allowed(declaration)} | {'yes' if name in kind.live else ''} |"
                )
    return "\n".join([*lines, ""])


def shown(value: Any) -> str:
    """A default as a parameter file has it."""
    return {"True": "true", "False": "false", "": "''"}.get(str(value), str(value))


def allowed(declaration: Declaration) -> str:
    """What a parameter may be."""
    least, most, words = declaration.least, declaration.most, declaration.words
    if not isfinite(least) or words.startswith("0 (") or "," in words:
        return words.removeprefix(declaration.description)
    end = f"{'below ' if words.startswith('<') else ''}{most:g}"
    return f"{'above ' if words.startswith('>') else ''}{least:g}{'' if most == inf else f' to {end}'}"


def commands() -> str:
    """Help of all commands, by group."""
    lines = [
        "# Commands",
        "",
        MADE,
        "",
        "Exit codes: 0 done, 1 done in part (a damaged bag, a full disk), 2 bad input "
        "(one line says what would be right), 130 interrupted by Ctrl-C.",
        "",
        "`--json` prints the results as one JSON object in SI units; warnings stay on stderr.",
        "",
        "Your shell completes commands and options after this line, which you may put into its startup file:",
        "",
        "| shell | line |",
        "|---|---|",
        '| bash | `eval "$(_KNEE_CONTACT_COMPLETE=bash_source knee-contact)"` |',
        '| zsh | `eval "$(_KNEE_CONTACT_COMPLETE=zsh_source knee-contact)"` |',
        "| fish | `_KNEE_CONTACT_COMPLETE=fish_source knee-contact \\| source` |",
    ]
    for heading, group in GROUPS.items():
        lines += ["", f"## {heading}"]
        for name in (str(command.name) for command in group):
            lines += ["", f"### {name}", "", "```text", help_of(name), "```"]
    return "\n".join([*lines, ""])


def help_of(name: str) -> str:
    """What `knee-contact NAME --help` prints."""
    command = knee_contact.commands[name]
    parent = click.Context(knee_contact, info_name="knee-contact")
    settings = {**command.context_settings, **knee_contact.context_settings}
    context = click.Context(
        command,
        info_name=name,
        parent=parent,
        max_content_width=WIDTH,
        terminal_width=WIDTH,
        **settings,
    )
    return command.get_help(context)


def messages() -> str:
    """Text of the messages."""
    lines = [
        "# Messages",
        "",
        MADE,
        "",
        "All values are in SI units. [Topics](topics.md) says who publishes what.",
    ]
    for name in ("KneeContact", "LoadEstimate"):
        text = (ROOT / "msg" / f"{name}.msg").read_text(encoding="utf-8").rstrip()
        lines += ["", f"## knee_contact_ros/msg/{name}", "", "```text", text, "```"]
    return "\n".join([*lines, ""])


def python() -> str:
    """Public names in Python with their docstrings."""
    lines = [
        "# Python",
        "",
        MADE,
        "",
        "`import knee_contact_ros` needs no ROS. [The how-to](../how-to/python.md) has "
        "examples. A name with dots is imported from that module of `knee_contact_ros`.",
    ]
    for heading, names in PYTHON.items():
        lines += ["", f"## {heading}"]
        for entry in names:
            name, _, members = entry.partition(": ")
            module, _, last = f"knee_contact_ros.{name}".rpartition(".")
            item = getattr(importlib.import_module(module), last)
            lines += ["", f"### {name}", *documented(last, item)]
            if inspect.isclass(item) and not issubclass(item, Exception):
                lines += ["", *(f"- {line}" for line in members_of(item, members.split()))]
    return "\n".join([*lines, ""])


def documented(name: str, item: Any) -> Iterator[str]:
    """Signature and docstring of a function, or docstring of a class."""
    if inspect.isroutine(item):
        yield from ("", "```python", f"{name}{signature(item)}", "```")
    yield from ("", text_of(item))


def signature(item: Any) -> str:
    """Names and defaults of the arguments; the docstring has their types and units."""
    arguments = [
        argument.replace(annotation=inspect.Parameter.empty)
        for argument in inspect.signature(item).parameters.values()
    ]
    return str(inspect.Signature(arguments))


def text_of(item: Any) -> str:
    """Docstring as Markdown: sections are paragraphs, their entries are lists, the example is a block of code."""
    text, _, example = (inspect.getdoc(item) or "").partition("\n\nExample:\n")
    text = re.sub(r"\n {4}(?! )(?=\S)", "\n- ", SECTION.sub(r"**\1**\n", text))
    text = re.sub(r"\n {8,}", " ", text).strip()
    return f"{text}\n\n```python\n{textwrap.dedent(example)}\n```" if example else text


def members_of(item: type, only: list[str]) -> Iterator[str]:
    """Public attributes and methods of a class, each with its first paragraph."""
    body: list[Any] = ast.parse(textwrap.dedent(inspect.getsource(item))).body[0].body  # type: ignore[attr-defined]
    for node, after in zip(body, [*body[1:], None], strict=True):
        if isinstance(node, ast.FunctionDef):
            name = node.name
            text = ast.get_docstring(node) or ""
            if not any(
                isinstance(each, ast.Name) and "property" in each.id
                for each in node.decorator_list
            ):
                name += signature(getattr(item, node.name))
        elif isinstance(node, ast.AnnAssign | ast.Assign):
            name = (node.target if isinstance(node, ast.AnnAssign) else node.targets[0]).id
            unit = re.search(r"Field\(\\?'([^']+)'", ast.unparse(node))
            said = after.value if isinstance(after, ast.Expr) else None
            text = inspect.cleandoc(said.value) if isinstance(said, ast.Constant) else ""
            text = f"[{unit[1]}] {text}" if unit else text
            if inspect.isclass(item) and isinstance(getattr(item, name, None), int):
                name += f" = {int(getattr(item, name))}"
        else:
            continue
        plain = name.partition("(")[0].partition(" ")[0]
        if not name.startswith("_") and (not only or plain in only):
            first = " ".join(text.split("\n\n")[0].split())
            yield f"`{name.replace('(self, ', '(').replace('(self)', '()')}`: {first}"


PAGES = {"parameters": parameters, "commands": commands, "messages": messages, "python": python}


def main() -> None:
    """Write all pages."""
    for name, page in PAGES.items():
        (REFERENCE / f"{name}.md").write_text(page(), encoding="utf-8")


if __name__ == "__main__":
    main()
