"""Nodes of other commits, each from a copy of its files with an environment of its own, which is made once."""

import io
import shutil
import subprocess
import tarfile
from functools import partial
from pathlib import Path

from benchmarks.latency.driver import Candidate, start_node

ROOT = Path(__file__).parents[2]


def name_of(commit: str) -> str:
    """Short name of a commit; see `candidate` for the error."""
    git = ["git", "-C", str(ROOT), "rev-parse", "--short=8", commit]
    return subprocess.check_output(git, text=True).strip()


def candidate(commit: str) -> Candidate:
    """Make the node of a commit a candidate: prepare its environment, in some minutes the first time.

    Raises:
        CalledProcessError: there is no such commit, or its environment cannot be made.
    """
    git = ["git", "-C", str(ROOT)]
    name = name_of(commit)
    folder = ROOT / "build" / "commits" / name
    if not folder.is_dir():
        packed = subprocess.check_output([*git, "archive", name])
        with tarfile.open(fileobj=io.BytesIO(packed)) as files:
            files.extractall(folder, filter="data")
    subprocess.run(
        [shutil.which("make") or "make", "--silent", ".venv/.installed"], cwd=folder, check=True
    )
    date = subprocess.check_output([*git, "log", "-1", "--format=%cs", name], text=True).strip()
    command = [str(folder / ".venv" / "bin" / "knee-contact"), "node"]
    parameters = [folder / "config" / "healthy.yaml"]
    begin = partial(start_node, command, parameters, {}, cwd=folder)
    return Candidate(f"this node as it was at {name} ({date})", begin)
