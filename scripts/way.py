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

from knee_contact_ros.system.processes import EXIT_PATIENCE, running
from knee_contact_ros.system.ros import private_graph

ROOT = Path(__file__).parents[1]
COMMAND = [sys.executable, "-m", "knee_contact_ros.commands.main"]
MODEL = ("model/",)


def files_on_the_way(work: Path) -> set[tuple[str, str]]:
    """Files of the package that a force passes, each with its way: `publish`, or `record` from there."""
    noted = work / "noted"
    noted.mkdir()
    tracing = os.pathsep.join([str(ROOT / "scripts" / "tracing"), str(ROOT)])
    traced = {"PYTHONPATH": tracing, "KNEE_CONTACT_WAY": str(noted)}
    node_command = [
        *COMMAND,
        "node",
        "--ros-args",
        "-p",
        f"record.path:={work / 'recording.mcap'}",
    ]
    bag = str(ROOT / "bags" / "gait2354_right")
    with private_graph() as graph, (work / "log").open("wb") as log:
        environment = os.environ | graph
        with running(node_command, log, EXIT_PATIENCE, env=environment | traced) as node:
            subprocess.run([*COMMAND, "replay", bag, "--wait", "120"], check=True, env=environment)
            time.sleep(1.0)  # the last forces are answered
            node.send_signal(signal.SIGINT)
            node.wait(EXIT_PATIENCE)
    lines = [
        line.split()
        for path in noted.iterdir()
        for line in path.read_text(encoding="utf-8").splitlines()
    ]
    return {(way, file) for way, file in lines if not file.startswith(MODEL)}


def main() -> None:
    """Print the files and their number."""
    with tempfile.TemporaryDirectory() as name:
        files = files_on_the_way(Path(name))
    for name, ways in (("to the topics", {"publish"}), ("to the file", {"publish", "record"})):
        passed = sorted({file for way, file in files if way in ways})
        print(f"{len(passed)} files outside the model {name}: {' '.join(passed)}")


if __name__ == "__main__":
    main()
