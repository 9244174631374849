"""`knee-contact table`: every number of every answer, as CSV and as Parquet."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from knee_contact_ros import solve
from knee_contact_ros.bags.reader import read_answers
from knee_contact_ros.commands.main import main
from knee_contact_ros.model.types import FLAT, TOLD
from knee_contact_ros.system.files import share_folder


@pytest.mark.parametrize("suffix", [".csv", ".parquet"])
@pytest.mark.parametrize("values", [{}, {"load.compartment": "both"}])
def test_a_table_has_every_number_of_every_answer(suffix: str, values: dict[str, str], tmp_path: Path) -> None:
    pandas = pytest.importorskip("pandas")
    if suffix == ".parquet":
        pytest.importorskip("pyarrow")
    recording, output = tmp_path / "out.mcap", tmp_path / f"table{suffix}"
    solve(share_folder() / "bags" / "gait2354_right", values, output=recording)
    assert main(["table", str(recording), "--output", str(output)]) == 0
    table = pandas.read_parquet(output) if suffix == ".parquet" else pandas.read_csv(output, engine="python")
    for topic in table["topic"].unique() if values else ["/knee_contact"]:
        answers = read_answers(recording, topic).view(FLAT)
        own = table[table["topic"] == topic] if values else table
        for name in ("stamp", *TOLD):
            assert np.array_equal(own[name], answers[name]), name
        assert np.allclose(own["time"], answers["stamp"] / 1e9, rtol=1e-15, atol=0.0)  # a rounding
    assert len(table) == 387 * (2 if values else 1)


def test_what_has_no_answers_is_told(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    bag = share_folder() / "bags" / "gait2354_right"
    assert main(["table", str(bag), "--output", str(tmp_path / "table.csv")]) == 2
    assert "has no answers: knee-contact solve computes them" in capsys.readouterr().err
    assert main(["table", str(bag), "--output", str(tmp_path / "table.xlsx")]) == 2
    assert not list(tmp_path.iterdir())
