"""The notebooks of the examples: kept without outputs, and run from the first cell to the last."""

import base64
import re
from pathlib import Path
from typing import Any

import pytest

from knee_contact_ros.system.files import share_folder

nbformat: Any = pytest.importorskip("nbformat")
nbclient: Any = pytest.importorskip("nbclient")
for needed in ("ipykernel", "pandas", "matplotlib"):
    pytest.importorskip(needed)
EXAMPLES = share_folder() / "examples"
PICTURES = {"knee": 2, "many_knees": 2, "own_data": 1}


def test_each_is_in_the_gallery():
    assert {path.stem for path in EXAMPLES.glob("*.ipynb")} == set(PICTURES)


@pytest.mark.parametrize("name", PICTURES)
def test_it_is_kept_without_outputs_and_runs(name):
    if name == "many_knees":
        pytest.importorskip("SALib")
    notebook = nbformat.read(EXAMPLES / f"{name}.ipynb", as_version=4)
    nbformat.validate(notebook)
    cells = [cell for cell in notebook.cells if cell.cell_type == "code"]
    assert [(cell.outputs, cell.execution_count) for cell in cells] == [([], None)] * len(cells)
    words = "\n".join(cell.source for cell in notebook.cells if cell.cell_type == "markdown")
    assert "pip install 'knee" not in words  # no registry has the package
    for link in re.findall(r"\]\((\.\./[^)#]+)", words):
        assert (EXAMPLES / Path(link)).exists(), link
    where = {"metadata": {"path": str(EXAMPLES)}}
    run = nbclient.NotebookClient(notebook, timeout=300, resources=where).execute()
    outputs = [output for cell in run.cells for output in cell.get("outputs", [])]
    told = [output.text for output in outputs if output.get("name") == "stderr"]
    assert [text for text in told if "compiling the model" not in text] == []
    pictures = [
        base64.b64decode(out.data["image/png"])
        for out in outputs
        if "image/png" in out.get("data", {})
    ]
    assert len(pictures) == PICTURES[name]  # each once
    assert all(picture.startswith(b"\x89PNG") for picture in pictures)
    texts = [
        output.data["text/plain"] for output in outputs if "text/plain" in output.get("data", {})
    ]
    assert max(len(text.splitlines()) for text in texts) <= 20
    if name == "own_data":  # ticks of a stream are those of a run
        assert any(
            output.text.endswith("True\n") for output in outputs if output.get("name") == "stdout"
        )
    if name == "knee":
        (printed,) = [output.text for output in outputs if output.get("name") == "stdout"]
        found, spread, hidden = map(float, re.findall(r"[\d.]+", printed))
        assert hidden == 4.0
        assert (
            abs(found - hidden) < 4.0 * spread < 0.4
        )  # [°] four standard deviations of what the noise leaves open
