"""Run the failed tests of live processes again, alone: beside three others a slow machine may miss their deadlines.

It ends with 1 if one fails again, or if another test had failed.
"""

import json
import subprocess
import sys
from pathlib import Path

LIVE = ("tests/ros/", "tests/node/", "tests/view/")
"""Folders whose tests start nodes, recorders and viewers"""

failed = json.loads(Path(".pytest_cache/v/cache/lastfailed").read_text("utf-8"))
# pytest-xdist puts the group of a test behind its name.
names = [name.partition("@")[0] for name in failed]
if not names:
    sys.exit("no test has failed: the run itself did")
if others := [name for name in names if not name.startswith(LIVE)]:
    sys.exit(f"failed, and not live: {', '.join(others)}")
sys.stderr.write(f"== Again, alone: {', '.join(names)}\n")
sys.exit(subprocess.run([sys.executable, "-m", "pytest", *names], check=False).returncode)
