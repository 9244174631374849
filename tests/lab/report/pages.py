"""The files of a report, read."""

import csv
import re

import numpy as np
import pytest


def page_of(folder):
    return (folder / "report.html").read_text(encoding="utf-8")


def text_of(folder):
    """The page without tags and pictures, in one line."""
    body = re.sub(r"<style>.*?</style>", " ", page_of(folder), flags=re.DOTALL)
    return " ".join(re.sub(r"<[^>]*>", " ", body).split())


def check_html(page):
    """Raise at the first error of an HTML5 page, where the parser is installed."""
    html5lib = pytest.importorskip(
        "html5lib", reason="html5lib is not installed (dependency group dev)"
    )
    html5lib.HTMLParser(strict=True).parse(page)


def rows_of(path):
    with path.open(encoding="utf-8", newline="") as file:
        return list(csv.DictReader(file))


def runs_of(path):
    """Rows by run."""
    rows = rows_of(path)
    return {
        run: [row for row in rows if row["run"] == run]
        for run in dict.fromkeys(row["run"] for row in rows)
    }


def numbers(rows, column):
    return np.array([float(row[column]) for row in rows])
