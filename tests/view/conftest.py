"""Recordings and scenes to be seen."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import pytest

from knee_contact_ros.offline.solve import solve
from knee_contact_ros.parameters.files import load_parameters
from knee_contact_ros.streams.contact_stream import ContactStream
from tests.helpers.answers import rows_of

if TYPE_CHECKING:
    from knee_contact_ros.streams.topics import Answer
    from knee_contact_ros.view.anatomy import KneeOutlines


@pytest.fixture(scope="session")
def osteoarthritic(config: Path, right_bag: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The osteoarthritic knee with its MRI profile."""
    path = tmp_path_factory.mktemp("recordings") / "osteoarthritic.mcap"
    parameters = load_parameters([config / "osteoarthritis.yaml", config / "mri_femur.yaml"])
    solve(right_bag, parameters, path, lambda *_: None)
    return path


@pytest.fixture(scope="package")
def knee(config: Path, right_bag: Path) -> tuple[KneeOutlines, list[Answer]]:
    """The osteoarthritic knee with its MRI profile, and its gait."""
    from knee_contact_ros.view.anatomy import drawing_of
    from tests.view.scenes import WEIGHT, answered

    pipeline = ContactStream(
        load_parameters([config / "osteoarthritis.yaml", config / "mri_femur.yaml"]), compiled=False
    )
    answers = answered(pipeline, right_bag)
    return drawing_of(pipeline.model, "knee", WEIGHT), answers


@pytest.fixture(scope="package")
def drawn(knee: tuple[KneeOutlines, list[Answer]], tmp_path_factory: pytest.TempPathFactory) -> Path:
    """All of it, drawn at once."""
    from tests.view.scenes import written

    drawing, answers = knee
    return written(tmp_path_factory.mktemp("drawn") / "knee.rrd", drawing, [rows_of(answers)])
