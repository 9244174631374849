"""What reports are made of."""

from __future__ import annotations

from pathlib import Path

import pytest

from knee_contact_ros.offline.solve import solve
from knee_contact_ros.parameters.files import load_parameters


@pytest.fixture(scope="module")
def bags(config: Path) -> tuple[Path, Path]:
    return config.parent / "bags" / "gait2354_right", config.parent / "bags" / "gait2354_left"


@pytest.fixture(scope="module")
def recording(
    tmp_path_factory: pytest.TempPathFactory, bags: tuple[Path, Path], config: Path
) -> Path:
    """The right knee as we record it."""
    path = tmp_path_factory.mktemp("recording") / "knee.mcap"
    solve(
        bags[0],
        load_parameters([config / "osteoarthritis.yaml", {"body_weight": 700.0}]),
        path,
    )
    return path
