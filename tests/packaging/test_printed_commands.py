"""What README, tutorials and how-to print runs as it stands: a shell, a folder and a Python session for each page.

Pages that print the same blocks share a shell and a folder; such a block runs once.
"""

import contextlib
import io
import os
import re
import subprocess
import sys
import threading
from pathlib import Path
from typing import Any, NamedTuple

import pytest
from domain_coordinator import domain_id

from tests import ROOT
from tests.helpers.needs import HAS_REPORT, HAS_VIEWER
from tests.helpers.warm import warm_commands

PAGES = [
    "README.md",
    *sorted(
        str(path.relative_to(ROOT))
        for kind in ("tutorials", "how-to")
        for path in (ROOT / "docs" / kind).glob("*.md")
    ),
]
TOGETHER = [
    ["README.md", "docs/tutorials/first-knee.md"],
    ["docs/tutorials/your-subject.md", "docs/how-to/surfaces-and-shares.md"],
]
"""Pages with blocks that are the same"""
ELSEWHERE = {"docs/tutorials/your-robot.md": "tests/ros/test_robot.py"}
"""Pages that are run by another test"""
GROUPS = TOGETHER + [
    [page]
    for page in PAGES
    if page not in {*ELSEWHERE, *(page for pages in TOGETHER for page in pages)}
]
BLOCK = re.compile(
    r"^(?P<before>[^\n]*)\n+```(?P<kind>\w+)\n(?P<text>.*?)^```$", re.MULTILINE | re.DOTALL
)
NEED = re.compile(r"<!-- not run: (.*) -->")
NEEDS = {
    "a download",
    "a screen",
    "apt",
    "OpenSim",
    "Docker",
    "ros2",
    "systemd",
    "other machines",
    "hours",
    "itself",
    "by tests/ros/test_demo.py",
    "by tests/lab/sweep/test_killed.py",
}
"""What a block may need that this test does not have, or which other test runs it"""
SAVED = re.compile(r"Save this as `([\w.]+)`")
INSTALLED = ROOT / ".venv" / ".installed"
OWN = Path(sys.prefix) == ROOT / ".venv" and INSTALLED.exists()
"""Whether this is the environment that `make demo` makes"""
TIMEOUT = 200.0
"""[s] for a block; a new machine compiles first"""
END = "@@ block ended"
OF_MAKE = ("MAKEFLAGS", "MAKEOVERRIDES", "MFLAGS", "MAKELEVEL", "ARGS")  # of `make test ARGS=...`

pytestmark = [
    pytest.mark.skipif(
        not (HAS_VIEWER and HAS_REPORT), reason="needs the environment that `make demo` makes"
    ),
    pytest.mark.filterwarnings("ignore"),
]


class Block(NamedTuple):
    """A block of a page, and the line before it."""

    before: str
    kind: str
    text: str


def blocks_of(page):
    """All blocks of a page that are shown with a language."""
    return [
        Block(*found.groups())
        for found in BLOCK.finditer((ROOT / page).read_text(encoding="utf-8"))
    ]


class Shell:
    """A shell in a folder, which keeps its variables and jobs from block to block."""

    def __init__(self, folder, programs, domain):
        self.programs = programs
        self.domain = domain
        self.printed: dict[str, str] = {}
        environment = {name: value for name, value in os.environ.items() if name not in OF_MAKE}
        environment |= {
            "PATH": f"{sys.prefix}/bin:{environment['PATH']}",
            "MPLBACKEND": "Agg",
            "COLUMNS": "120",
        }
        self.process = subprocess.Popen(
            ["/bin/bash", "-e", "-o", "pipefail"],
            cwd=folder,
            env=environment,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            start_new_session=True,
        )

    def run(self, text):
        """Run a block; return what it prints."""
        assert self.process.stdin
        assert self.process.stdout
        text = re.sub(r"ROS_DOMAIN_ID=\d+", f"ROS_DOMAIN_ID={self.domain}", text)
        path = f"PATH={self.programs}:$PATH"  # before that of an environment that a page activates
        self.process.stdin.write(f"{path}\n{{ {text}\n}} < /dev/null\necho '{END}'\n")
        self.process.stdin.flush()
        timer = threading.Timer(TIMEOUT, self.close)
        timer.start()
        printed = ""
        try:
            for line in self.process.stdout:
                printed += line.replace(f"{END}\n", "")
                if line.endswith(f"{END}\n"):
                    return printed
        finally:
            timer.cancel()
        raise AssertionError(f"failed:\n{text}\n{printed}")

    def close(self):
        """End the shell and all that it has started."""
        with contextlib.suppress(ProcessLookupError):
            os.killpg(self.process.pid, 9)
        self.process.wait()


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """The folder of the sources, as links, so that what the commands write stays out of it."""
    for path in ROOT.iterdir():
        if path.name not in ("knee_contact_demo", ".git", ".venv"):
            (tmp_path / path.name).symlink_to(path)
    (tmp_path / ".venv").symlink_to(sys.prefix)
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("MPLBACKEND", "Agg")
    return tmp_path


@pytest.fixture(scope="session")
def programs(tmp_path_factory):
    """A folder with a `knee-contact` that starts at once; `make demo` runs the installed one."""
    with warm_commands(tmp_path_factory.mktemp("warm")) as programs:
        yield programs


@pytest.fixture
def shell(folder, programs):
    """A shell in that folder, with a ROS domain that no other test has."""
    with domain_id() as domain:
        shell = Shell(folder, programs, domain)
        yield shell
        shell.close()


@pytest.mark.parametrize("pages", GROUPS, ids=" ".join)
def test_what_a_page_prints_runs_and_prints_what_is_shown(pages, shell, folder):
    names: dict[str, Any] = {"__name__": "page"}
    printed = ""
    for before, kind, text in [block for page in pages for block in blocks_of(page)]:
        if need := NEED.search(before):
            assert need[1] in NEEDS
            printed = ""
        elif saved := SAVED.search(before):
            (folder / saved[1]).write_text(text, encoding="utf-8")
        elif kind == "sh":
            if text not in shell.printed:
                shell.printed[text] = shell.run(
                    text if OWN else re.sub("^make demo", "knee-contact demo", text)
                )
            printed = shell.printed[text]
        elif kind == "python":
            with contextlib.redirect_stdout(io.StringIO()) as out:
                exec(compile(text, pages[-1], "exec"), names)  # noqa: S102
            printed = out.getvalue()
        elif kind == "text" and printed:
            lines = [line.rstrip() for line in printed.splitlines()]
            for line in text.splitlines():
                assert any(each.startswith(line.rstrip()) for each in lines), (
                    f"{line!r} is not in\n{printed}"
                )
            printed = ""


@pytest.mark.parametrize("page", PAGES)
def test_pictures_and_files_that_a_page_names_are_there(page):
    for name in re.findall(
        r"`((?:examples|config|bags|docs)/[\w/.-]+)`", (ROOT / page).read_text(encoding="utf-8")
    ):
        assert (ROOT / name).exists(), name
