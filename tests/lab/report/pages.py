"""The files of a report, read."""

from __future__ import annotations

import csv
import re
from pathlib import Path

import numpy as np
import pytest


def page_of(folder: Path) -> str:
    return (folder / "report.html").read_text(encoding="utf-8")


def text_of(folder: Path) -> str:
    """The page without tags and pictures, in one line."""
    body = re.sub(r"<style>.*?</style>", " ", page_of(folder), flags=re.DOTALL)
    return " ".join(re.sub(r"<[^>]*>", " ", body).split())


def check_html(page: str) -> None:
    """Raise at the first error of an HTML5 page, where the parser is installed."""
    html5lib = pytest.importorskip(
        "html5lib", reason="html5lib is not installed (dependency group dev)"
    )
    html5lib.HTMLParser(strict=True).parse(page)


def rows_of(path: Path) -> list[dict[str, str]]:
    with path.open(encoding="utf-8", newline="") as file:
        return list(csv.DictReader(file))


def runs_of(path: Path) -> dict[str, list[dict[str, str]]]:
    """Rows by run."""
    rows = rows_of(path)
    return {
        run: [row for row in rows if row["run"] == run]
        for run in dict.fromkeys(row["run"] for row in rows)
    }


def numbers(rows: list[dict[str, str]], column: str) -> np.ndarray:
    return np.array([float(row[column]) for row in rows])
