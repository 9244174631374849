"""docs/studies/reproduction.md says what the code gives, and its key numbers are those that must come out."""

import pytest

from tests import ROOT

pytest.importorskip("tabulate", reason="the studies' tables")

from studies.reproduction.__main__ import write

PAGES = ROOT / "docs" / "studies"


def test_page_and_tables_are_up_to_date(tmp_path):
    write(tmp_path, "some machine")
    kept = {
        path.name: _but_machine(path)
        for path in [PAGES / "reproduction.md", *(PAGES / "reproduction").iterdir()]
    }
    made = {path.name: _but_machine(path) for path in tmp_path.rglob("*.*")}
    assert made == kept, "run python -m studies.reproduction"


def _but_machine(page):
    """Words of the lines; how wide a column is set depends on a library that may measure letters."""
    lines = page.read_text(encoding="utf-8").splitlines()
    return [line.replace("-", " ").split() for line in lines if not line.startswith("Made by")]
