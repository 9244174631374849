"""The defaults that the pages name are those of the code."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

from ruamel.yaml import YAML

from knee_contact_ros.parameters.files import flat_parameters, load_parameters
from knee_contact_ros.parameters.schema import LoadParameters
from tests import ROOT

DOCS = ROOT / "docs"
LOAD = "load.md"
ROW = re.compile(r"^\| `([a-z_]+\.[a-z_]+)` \| `([^`]+)` \|", re.MULTILINE)
"""Of a table of parameters: name and default"""
DEFAULTS = flat_parameters(load_parameters({}))


def named_in(page: Path) -> dict[str, Any]:
    rows = ROW.findall(page.read_text(encoding="utf-8"))
    return {name: YAML(typ="safe", pure=True).load(default) for name, default in rows}


def test_tables_of_parameters_name_the_defaults() -> None:
    named: dict[str, Any] = {}
    for page in DOCS.glob("*.md"):
        named |= {} if page.name == LOAD else named_in(page)
    assert named == {name: DEFAULTS[name] for name in named}
    assert {name for name in DEFAULTS if name.startswith("record.")} <= set(named)


def test_the_table_of_the_load_node_names_its_defaults() -> None:
    named, defaults = named_in(DOCS / LOAD), flat_parameters(load_parameters({}, LoadParameters))
    assert named == {name: defaults[name] for name in named}
    assert {"ground.components", "ground.axes"} <= set(named)


def test_the_deadline_is_the_one_that_is_told() -> None:
    (told,) = re.findall(r"`deadline` \(([0-9.]+) s\)", (DOCS / "node.md").read_text(encoding="utf-8"))
    assert float(told) == DEFAULTS["deadline"]
