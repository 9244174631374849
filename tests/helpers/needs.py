"""What tests need that need not be installed."""

from __future__ import annotations

from importlib.metadata import PackageNotFoundError, version
from importlib.util import find_spec

import pytest

from tests import ROOT


def has_at_least(package: str, *least: int) -> bool:
    """Whether a package is installed, in this version or a later one."""
    try:
        return tuple(map(int, version(package).split(".")[: len(least)])) >= least
    except PackageNotFoundError:
        return False


HAS_VIEWER = find_spec("rerun") is not None
"""Whether Rerun is there"""
HAS_REPORT = has_at_least("matplotlib", 3, 7)
"""Whether Matplotlib is there, and new enough for reports"""
HAS_PICTURE = find_spec("matplotlib") is not None
"""Whether it is there at all: any version draws the knee at its peak"""
TRIALS = ROOT.parent / "shared" / "data" / "instrumented_knee"
"""Two walking trials of a knee with an instrumented implant; not ours to pass on"""
needs_trials = pytest.mark.skipif(not TRIALS.is_dir(), reason="needs the measured trials")
needs_viewer = pytest.mark.skipif(not HAS_VIEWER, reason="needs the extra viewer")
needs_opensim = pytest.mark.skipif(find_spec("opensim") is None, reason="needs the extra opensim")
"""OpenSim is not imported here: that sets LD_LIBRARY_PATH to PATH, and no ROS process could be started by the tests"""
