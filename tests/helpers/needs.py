"""What tests need that need not be installed."""

import os
import re
import shutil
from collections import Counter
from importlib.metadata import PackageNotFoundError, version
from importlib.util import find_spec

import pytest

INSTALL = ".venv/bin/uv pip install --editable"
ENABLED_BY = {
    r"needs the extra (\w+).*": rf"{INSTALL} '.[\1]'",
    r".*dependency group (\w+).*": r".venv/bin/uv pip install --group \1",
    r".*ROS package.*": 'CONTRIBUTING.md, "ROS tools from source"',
    r".*Debian: (apt install .*?)\)?$": r"\1",
}
"""What enables a test, by a pattern of the reason why it is skipped"""


def skipped_in_a_line(reports):
    """Return how many tests were skipped (`longrepr` of each), and the command that enables each kind of them."""
    commands = Counter()
    for report in reports:
        reason = report[2] if isinstance(report, tuple) else str(report)
        reason = reason.removeprefix("Skipped: ")
        for pattern, command in ENABLED_BY.items():
            reason = re.sub(f"^{pattern}$", command, reason)
        commands[reason] += 1
    kinds = "; ".join(f"{count}: {command}" for command, count in commands.most_common())
    return f"{commands.total()} tests are skipped; what enables them: {kinds}"


def has_at_least(package, *least):
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
needs_viewer = pytest.mark.skipif(not HAS_VIEWER, reason="needs the extra viewer")
needs_compiler = pytest.mark.skipif(
    not shutil.which(os.environ.get("CC", "cc")),
    reason="needs a compiler (Debian: apt install gcc)",
)
"""The reference solver of the studies is in C"""
needs_opensim = pytest.mark.skipif(find_spec("opensim") is None, reason="needs the extra opensim")
"""OpenSim is not imported here: that sets LD_LIBRARY_PATH to PATH, and no ROS process could be started by the tests"""
