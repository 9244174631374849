"""Recordings and scenes to be seen."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import pytest

from knee_contact_ros.parameters.files import load_parameters
from knee_contact_ros.streams.contact_pipeline import ContactPipeline
from tests.helpers.offline import solve

if TYPE_CHECKING:
    from knee_contact_ros.model.types import Rows
    from knee_contact_ros.view.anatomy import KneeOutlines


@pytest.fixture(scope="session")
def osteoarthritic(right_bag: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A recording of the osteoarthritic knee with its MRI profile."""
    path = tmp_path_factory.mktemp("recordings") / "osteoarthritic.mcap"
    parameters = load_parameters(["osteoarthritis", "mri_femur"])
    solve(right_bag, parameters, path)
    return path


@pytest.fixture(scope="package")
def knee(right_bag: Path) -> tuple[KneeOutlines, Rows]:
    """The same knee, and its gait."""
    from knee_contact_ros.view.anatomy import outlines_of
    from tests.view.scenes import WEIGHT, answered

    stream = ContactPipeline(
        load_parameters(["osteoarthritis", "mri_femur"]),
        compiled=False,
    )
    rows = answered(stream, right_bag)
    return outlines_of(stream.model, "knee", WEIGHT), rows


@pytest.fixture(scope="package")
def drawn(knee: tuple[KneeOutlines, Rows], tmp_path_factory: pytest.TempPathFactory) -> Path:
    """All of it, drawn at once."""
    from tests.view.scenes import written

    drawing, rows = knee
    return written(tmp_path_factory.mktemp("drawn") / "knee.rrd", drawing, [rows])
