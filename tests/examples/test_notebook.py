"""The notebook of the examples: kept without outputs, and run from its first cell to its last."""

from __future__ import annotations

import base64
import re
from typing import Any

import pytest

from knee_contact_ros.system.files import share_folder

nbformat: Any = pytest.importorskip("nbformat")
nbclient: Any = pytest.importorskip("nbclient")
for needed in ("ipykernel", "pandas", "matplotlib"):
    pytest.importorskip(needed)
EXAMPLES = share_folder() / "examples"


@pytest.fixture(scope="module")
def notebook() -> Any:
    return nbformat.read(EXAMPLES / "knee.ipynb", as_version=4)


def test_it_is_kept_without_outputs(notebook: Any) -> None:
    nbformat.validate(notebook)
    cells = [cell for cell in notebook.cells if cell.cell_type == "code"]
    assert [cell.outputs for cell in cells] == [[]] * len(cells)
    assert {cell.execution_count for cell in cells} == {None}


def test_it_runs_and_finds_the_angle_that_was_hidden(notebook: Any) -> None:
    where = {"metadata": {"path": str(EXAMPLES)}}
    run = nbclient.NotebookClient(notebook, timeout=300, resources=where).execute()
    outputs = [output for cell in run.cells for output in cell.get("outputs", [])]
    tables = [output.data["text/html"] for output in outputs if "text/html" in output.get("data", {})]
    assert tables[0].startswith("<p>387 ticks over 1.930 s, at most 16")
    pictures = [base64.b64decode(out.data["image/png"]) for out in outputs if "image/png" in out.get("data", {})]
    assert len(pictures) == 2  # each once
    assert all(picture.startswith(b"\x89PNG") for picture in pictures)
    (printed,) = [output.text for output in outputs if output.get("name") == "stdout"]
    found, spread, hidden = map(float, re.findall(r"[\d.]+", printed))
    assert hidden == 4.0
    assert abs(found - hidden) < 4.0 * spread < 0.4  # [°] four standard deviations of what the noise leaves open
    assert [output.text for output in outputs if output.get("name") == "stderr"] == []
