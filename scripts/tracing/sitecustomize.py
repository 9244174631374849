"""Note the files of the package that a force passes; Python loads this in every process of the node (`scripts/way.py`).

Noted is what the functions of a way call: a node takes a force and publishes the answer; it hands the answer over and
sends it, and a recorder writes it.
"""

from __future__ import annotations

import atexit
import os
import sys
import threading
from pathlib import Path
from types import FrameType
from typing import Any

PUBLISHES = ("inputs.py", "_on_message")
RECORDS = {
    ("outputs.py", "put"),
    ("outputs.py", "_send_batch"),
    *((file, name) for file in ("recorder.py", "recorder.py") for name in ("write", "flush")),
}
"""Functions at which the way to the topics and the way on to the file begin, by file and name"""
FORCE = "joint_reaction_force"
FOLDER = os.environ["KNEE_CONTACT_WAY"]
"""Folder for a file with what each process has noted: a way and a file in each line"""
PART = "/knee_contact_ros/"
seen: set[str] = set()
within = threading.local()


def way_from(frame: FrameType) -> str:
    """Name the way that begins with a call, if any; of messages, only those of the force count."""
    place = frame.f_code.co_filename.rpartition("/")[2], frame.f_code.co_name
    if place == PUBLISHES and getattr(frame.f_locals.get("self"), "topic", "") == FORCE:
        return "publish"
    return "record" if place in RECORDS else ""


def look(frame: FrameType, event: str, _argument: Any) -> None:
    """Note the file of a call, within a way."""
    if event not in ("call", "return") or PART not in frame.f_code.co_filename:
        return
    ways = within.__dict__.setdefault("ways", [])
    if event == "return":
        if ways and ways[-1][0] is frame:
            ways.pop()
        return
    if way := way_from(frame):
        ways.append((frame, way))
    if ways:
        seen.add(f"{ways[-1][1]} {frame.f_code.co_filename.rpartition(PART)[2]}")


def put_down() -> None:
    """Write what was noted."""
    Path(FOLDER, str(os.getpid())).write_text("\n".join(sorted(seen)), encoding="utf-8")


atexit.register(put_down)
threading.setprofile(look)
sys.setprofile(look)
