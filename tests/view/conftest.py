"""Recordings and scenes to be seen."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest

from knee_contact_ros.parameters.files import load_parameters
from knee_contact_ros.streams.contact_pipeline import ContactPipeline
from tests.helpers.offline import solve

if TYPE_CHECKING:
    pass


@pytest.fixture(scope="session")
def osteoarthritic(right_bag, tmp_path_factory):
    """A recording of the osteoarthritic knee with its MRI profile."""
    path = tmp_path_factory.mktemp("recordings") / "osteoarthritic.mcap"
    parameters = load_parameters(["osteoarthritis", "mri_femur"])
    solve(right_bag, parameters, path)
    return path


@pytest.fixture(scope="package")
def knee(right_bag):
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
def drawn(knee, tmp_path_factory):
    """All of it, drawn at once."""
    from tests.view.scenes import written

    drawing, rows = knee
    return written(tmp_path_factory.mktemp("drawn") / "knee.rrd", drawing, [rows])
