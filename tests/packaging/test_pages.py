"""Pages are short, plain and up to date."""

from __future__ import annotations

import pytest

from scripts.make_reference import PAGES, REFERENCE
from tests import ROOT

DECISIONS = sorted(path for path in (ROOT / "docs" / "decisions").glob("*.md") if path.name != "README.md")


@pytest.mark.parametrize("name", PAGES)
def test_the_reference_is_what_the_code_says(name: str) -> None:
    page = (REFERENCE / f"{name}.md").read_text(encoding="utf-8")
    assert page == PAGES[name](), "run python -m scripts.make_reference"


def test_decisions_are_few_and_short() -> None:
    assert len(DECISIONS) <= 20
    assert {path.name for path in DECISIONS if len(path.read_text(encoding="utf-8").split()) > 260} == set()
