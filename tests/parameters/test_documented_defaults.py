"""The defaults that the pages name are those of the code."""

from __future__ import annotations

import re

from ruamel.yaml import YAML

from knee_contact_ros.parameters.reading import flat_parameters, load_parameters
from tests import ROOT

DOCS = ROOT / "docs"
ROW = re.compile(r"^\| `([a-z_]+\.[a-z_]+)` \| `([^`]+)` \|", re.MULTILINE)
"""Of a table of parameters: name and default"""
DEFAULTS = flat_parameters(load_parameters({}))


def test_tables_of_parameters_name_the_defaults() -> None:
    named = {}
    for page in DOCS.glob("*.md"):
        rows = ROW.findall(page.read_text(encoding="utf-8"))
        named |= {name: YAML(typ="safe", pure=True).load(default) for name, default in rows}
    assert named == {name: DEFAULTS[name] for name in named}
    assert {name for name in DEFAULTS if name.startswith("record.")} <= set(named)


def test_the_deadline_is_the_one_that_is_told() -> None:
    (told,) = re.findall(r"`deadline` \(([0-9.]+) s\)", (DOCS / "node.md").read_text(encoding="utf-8"))
    assert float(told) == DEFAULTS["deadline"]
