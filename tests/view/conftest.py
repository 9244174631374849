"""Recordings to be seen."""

from __future__ import annotations

from pathlib import Path

import pytest

from knee_contact_ros.offline.solve import solve
from knee_contact_ros.parameters.reading import load_parameters


@pytest.fixture(scope="session")
def osteoarthritic(config: Path, right_bag: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The osteoarthritic knee with its MRI profile."""
    path = tmp_path_factory.mktemp("recordings") / "osteoarthritic.mcap"
    parameters = load_parameters([config / "osteoarthritis.yaml", config / "mri_femur.yaml"])
    solve(right_bag, parameters, path, lambda *_: None)
    return path
