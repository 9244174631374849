"""Texts of others on a terminal and in a log."""

import subprocess
import sys

from knee_contact_ros.bags.recover import Recovery, TopicCount
from knee_contact_ros.commands.tables import show_recovery, show_summary
from knee_contact_ros.offline.summary import read_summary
from knee_contact_ros.streams.messages import RefusedSampleError
from knee_contact_ros.system.errors import UsageError, list_names, printable
from knee_contact_ros.system.terminal import say, warn
from tests.helpers.terminals import Terminal

EVIL = "\x1b]0;mine\x07\x1b[2Jtopic\u202e\r\x9b31m[/red]\udc80"
SHOWN = r"\x1b]0;mine\x07\x1b[2Jtopic\u202e\r\x9b31m[/red]\udc80"


def test_unprintable_characters_are_escaped():
    assert printable(EVIL) == SHOWN
    assert printable("µm Knie 膝 [a] \\x1b") == "µm Knie 膝 [a] \\x1b"


def test_lists_are_cut():
    assert list_names([EVIL, "b"]) == f"{SHOWN}, b"
    assert list_names([str(number) for number in range(30)]).endswith("18, 19 and 10 more")
    assert list_names(["a" * 101]) == f"{'a' * 100}..."


def test_errors_are_printable_lines():
    assert str(UsageError(f"a\nb {EVIL}")) == f"a b {SHOWN}".replace(r"\r", " ")
    assert str(RefusedSampleError("joint_missing", EVIL)) == SHOWN


def test_printed_lines_have_no_escape_codes(old_recording, capsys):
    say(EVIL, err=True)
    warn([EVIL])
    show_recovery(Recovery([TopicCount(EVIL, EVIL, 1, 2)], (0, 1), 1, 1, [EVIL]), EVIL)
    show_summary(read_summary(old_recording, 737.0), {"parameters": EVIL}, {"Recording": EVIL})
    told = capsys.readouterr()
    assert (told.out + told.err).replace("\n", "").isprintable()
    assert told.out.count("mine") == 6
    assert told.err.count(SHOWN) == 2


PROGRAM = """
from knee_contact_ros.system.progress import progress

with progress("\x1b]0;mine\x07[/red]") as advance:
    for done in range(1, 300_001):
        advance(done, 300_000)
    advance.describe("\x1b]0;mine\x07[/green]")
"""


def test_a_bar_has_no_escape_codes_and_a_pipe_has_no_bar():
    with Terminal(sys.executable, "-c", PROGRAM) as terminal:
        terminal.wait_for(r"\\x1b\]0;mine\\x07\[/red\]")
        terminal.wait_for(r"\\x1b\]0;mine\\x07\[/green\].*100%")
        terminal.wait_for(r"\[ended with 0, usual\]")
    done = subprocess.run(
        [sys.executable, "-c", PROGRAM], capture_output=True, text=True, check=True, timeout=60
    )
    assert (done.stdout, done.stderr) == ("", "")
