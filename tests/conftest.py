"""Fixtures that several tests need."""

from __future__ import annotations

from pathlib import Path

import pytest
from hypothesis import settings

from knee_contact_ros.resources import share_folder

settings.register_profile("no timed tests", deadline=None)
settings.load_profile("no timed tests")

REFERENCE_DATA = Path(__file__).resolve().parents[2] / "shared" / "data"


@pytest.fixture(scope="session")
def config() -> Path:
    """Folder of the shipped parameter files."""
    return share_folder() / "config"


@pytest.fixture(scope="session")
def right_bag() -> Path:
    """The shipped gait of the right leg."""
    return share_folder() / "bags" / "gait2354_right"


@pytest.fixture(scope="session")
def reference_data() -> Path:
    """Answers of an independent solver and the tables that the bags were made from; not part of the project."""
    if not REFERENCE_DATA.is_dir():
        pytest.skip("the reference data are not on this machine")
    return REFERENCE_DATA
