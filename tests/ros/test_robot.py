"""The tutorial "Your robot in 20 minutes": every line as it is printed, in one shell, with a robot that walks."""

import os
import re
import shlex
import subprocess
import sys
from itertools import pairwise

import numpy as np

from knee_contact_ros.bags.answers import read_answers
from knee_contact_ros.model.types import FLAT, MESSAGE_FIELDS, UNUSABLE
from knee_contact_ros.streams.strides import strides_of
from knee_contact_ros.streams.topics import NANOSECONDS
from tests import ROOT

BLOCK = re.compile(r"^```(sh|text)\n(.*?)^```$", re.MULTILINE | re.DOTALL)
PAGE = (ROOT / "docs" / "tutorials" / "your-robot.md").read_text(encoding="utf-8")
STRIDE = 1.1
"""[s] of the robot's walk"""
TIMEOUT = 400.0  # a new machine compiles first
HEAD = """
exec > said 2>&1
await() {
    for line in "$@"; do until grep --quiet --fixed-strings -- "$line" said; do sleep 0.1; done; done
    sleep 2.5
}
"""
"""Begin of the script: what waits for lines, and then for two strides"""


def sources(folder):
    """The folder of the sources, as links; its environment is the one that runs the tests."""
    for path in ROOT.iterdir():
        if path.name not in (".git", ".venv"):
            (folder / path.name).symlink_to(path)
    programs = folder / ".venv" / "bin"
    programs.mkdir(parents=True)
    for name, words in (("python", ""), ("knee-contact", "-m knee_contact_ros.commands.main")):
        (programs / name).write_text(f'#!/bin/sh\nexec {sys.executable} {words} "$@"\n')
        (programs / name).chmod(0o755)
    (programs / "activate").write_text(f"export PATH={programs}:$PATH PYTHONPATH={ROOT}\n")


def awaiting(block, shown):
    """A block that waits for the lines which are shown, instead of for so many seconds."""
    lines = " ".join(map(shlex.quote, shown.splitlines()))
    block = re.sub(r"^sleep \d+$", f"await {lines}", block, flags=re.MULTILINE)
    return re.sub(
        r"^timeout \d+ (.*) \|\| true$",
        rf"\1 & await {lines}; kill $!; wait",
        block,
        flags=re.MULTILINE,
    )


def test_the_page_is_short():
    assert len(PAGE.split()) <= 1200


def test_every_line_does_what_the_page_says(tmp_path):
    sources(tmp_path)
    blocks = [*BLOCK.findall(PAGE), ("", "")]
    script = HEAD + "".join(
        awaiting(text, shown if kind == "text" else "")
        for (here, text), (kind, shown) in pairwise(blocks)
        if here == "sh"
    )
    done = subprocess.run(
        ["/bin/bash", "-e", "-c", script],
        cwd=tmp_path,
        env=os.environ,
        stdin=subprocess.DEVNULL,
        timeout=TIMEOUT,
        check=False,
    )
    said = (tmp_path / "said").read_text()
    assert done.returncode == 0, said
    for line in "".join(text for kind, text in blocks if kind == "text").splitlines():
        assert line in said, f"{line}\n{said}"
    live, again = (read_answers(tmp_path / name) for name in ("walk.mcap", "again.mcap"))
    assert np.array_equal(
        live.view(FLAT)[list(MESSAGE_FIELDS)], again.view(FLAT)[list(MESSAGE_FIELDS)]
    )
    assert len(live) > 500
    assert (live["status"] & UNUSABLE == 0).mean() > 0.9  # a busy machine may be late
    strides = strides_of(live, 737.0)
    seconds = (live["stamp"][-1] - live["stamp"][0]) / NANOSECONDS  # a busy machine starts late
    assert len(strides) > 0.7 * seconds / STRIDE
    assert abs(np.median([each.span.duration for each in strides]) - STRIDE) < 0.02
