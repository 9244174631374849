"""The tutorial's commands do what the page says, as they stand in it."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

from tests import ROOT
from tests.helpers.needs import HAS_REPORT, HAS_VIEWER

BLOCK = re.compile(r"^```(sh|text)\n(.*?)^```$", re.MULTILINE | re.DOTALL)
INSTALLED = ROOT / ".venv" / ".installed"
IMAGES = re.compile(r"`(\w+/\w+\.(?:png|html|csv))`")
TIMEOUT = 400.0  # a new machine compiles first

pytestmark = pytest.mark.skipif(
    not (HAS_VIEWER and HAS_REPORT and Path(sys.prefix) == ROOT / ".venv" and INSTALLED.exists()),
    reason="needs the environment that `make demo` makes",
)


@pytest.fixture
def sources(tmp_path: Path) -> Path:
    """The folder of the sources, as links, so that what the commands write stays out of it."""
    for path in ROOT.iterdir():
        if path.name not in ("knee_contact_demo", ".git"):
            (tmp_path / path.name).symlink_to(path)
    return tmp_path


def test_every_command_prints_what_the_page_shows(sources: Path) -> None:
    page = (ROOT / "docs" / "tutorial.md").read_text(encoding="utf-8")
    blocks = BLOCK.findall(page)
    assert len(blocks) == 2 * len([kind for kind, _ in blocks if kind == "sh"])
    of_make = ("MAKEFLAGS", "MAKEOVERRIDES", "MFLAGS", "MAKELEVEL", "ARGS")  # of `make test ARGS=...`
    environment = {name: value for name, value in os.environ.items() if name not in of_make}
    for (kind, commands), (shown, expected) in zip(blocks[::2], blocks[1::2], strict=True):
        assert (kind, shown) == ("sh", "text")
        done = subprocess.run(
            ["/bin/bash", "-e", "-c", commands], cwd=sources, env=environment, stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, timeout=TIMEOUT, check=False,
        )  # fmt: skip
        assert done.returncode == 0, done.stdout
        printed = [line.rstrip() for line in done.stdout.splitlines()]
        for line in expected.splitlines():
            if "peak " in line:  # live: the last digit of the contact force is not told
                assert any(each.startswith(line) for each in printed), done.stdout
            else:
                assert line.rstrip() in printed, done.stdout
    named = set(IMAGES.findall(page))
    assert named
    assert {name for name in named if not (sources / name).is_file()} == set()
