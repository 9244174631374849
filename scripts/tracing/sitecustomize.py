"""Note the files of the package that a force passes; Python loads this in every process of the node (`scripts/way.py`).

Noted is what one of `BEGINS` calls: a node takes a force, hands over its answer and sends it; a recorder writes it.
"""

from __future__ import annotations

import atexit
import os
import sys
import threading
from pathlib import Path
from types import FrameType
from typing import Any

BEGINS = {
    ("subscription.py", "_on_message"), ("process.py", "put"), ("process.py", "_send_batch"), ("worker.py", "_next"),
    ("answer_recorder.py", "write"), ("answer_recorder.py", "flush"),
}  # fmt: skip
FORCE = "joint_reaction_force"
FOLDER = os.environ["KNEE_CONTACT_WAY"]
"""Folder for a file with the names that each process has noted"""
PART = "/knee_contact_ros/"
seen: set[str] = set()
within = threading.local()


def begins(frame: FrameType) -> bool:
    """Whether a call begins a way: of messages, only those of the force count."""
    place, name = frame.f_code.co_filename.rpartition("/")[2], frame.f_code.co_name
    if name == "_on_message":
        return getattr(frame.f_locals.get("self"), "topic", "") == FORCE
    return (place, name) in BEGINS


def look(frame: FrameType, event: str, _argument: Any) -> None:
    """Note the file of a call, within a way."""
    if event not in ("call", "return") or PART not in frame.f_code.co_filename:
        return
    first = getattr(within, "first", None)
    if event == "return":
        within.first = None if frame is first else first
        return
    if first is None and begins(frame):
        within.first = first = frame
    if first is not None:
        seen.add(frame.f_code.co_filename.rpartition(PART)[2])


def put_down() -> None:
    """Write what was noted."""
    Path(FOLDER, str(os.getpid())).write_text("\n".join(sorted(seen)), encoding="utf-8")


atexit.register(put_down)
threading.setprofile(look)
sys.setprofile(look)
