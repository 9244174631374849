"""Count the files outside the model that a force passes from callback to MCAP, by `python -m scripts.way`.

A real node with a recording hears the shipped gait; what is called in its processes is noted (`scripts/tracing`).
"""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

ROOT = Path(__file__).parents[1]
COMMAND = [sys.executable, "-m", "knee_contact_ros.cli.main"]
MODEL = ("core/", "compiled/")


def files_on_the_way(work: Path) -> set[str]:
    """Files of the package that a force passes, as paths in it."""
    noted = work / "noted"
    noted.mkdir()
    graph = {"ROS_DOMAIN_ID": "77", "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"}
    traced = {
        "PYTHONPATH": os.pathsep.join([str(ROOT / "scripts" / "tracing"), str(ROOT)]),
        "KNEE_CONTACT_WAY": str(noted),
    }
    recording = f"record.path:={work / 'recording.mcap'}"
    node = subprocess.Popen([*COMMAND, "node", "--ros-args", "-p", recording], env=os.environ | graph | traced)
    bag = str(ROOT / "bags" / "gait2354_right")
    subprocess.run([*COMMAND, "replay", bag, "--wait", "60"], check=True, env=os.environ | graph)
    time.sleep(1.0)
    node.send_signal(signal.SIGINT)
    node.wait(60)
    return {name for path in noted.iterdir() for name in path.read_text(encoding="utf-8").split()}


def main() -> None:
    """Print the files and their number."""
    with tempfile.TemporaryDirectory() as name:
        files = files_on_the_way(Path(name))
    outside = sorted(file for file in files if not file.startswith(MODEL))
    print("\n".join(outside))
    print(f"{len(outside)} files outside the model")


if __name__ == "__main__":
    main()
