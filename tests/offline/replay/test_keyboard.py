"""Keys from a real terminal (a pseudo-terminal with a shell), and the terminal as it was, whatever ends the program."""

import os
import signal
import subprocess
import sys

import pytest

from tests.helpers.terminals import Terminal

PROGRAM = """
import os
from knee_contact_ros.commands.player import Command, commands_of
from knee_contact_ros.system.keyboard import Keyboard
from knee_contact_ros.system.processes import unwinding_on_signals

def stood_still(seconds):  # in a signal handler, which may interrupt a print
    os.write(1, f"<stood still for {seconds}>\\n".encode())

with unwinding_on_signals(), Keyboard(stood_still) as keyboard:
    keyboard.wait_for_keys(0.0)
    while True:
        if keyboard._saved_modes is not None:
            print("<ready>", flush=True)
            break
        keyboard.wait_for_keys(0.05)
    while True:
        for command in commands_of(keyboard.wait_for_keys(0.05)):
            print(f"<{command.name}>", flush=True)
            if command is Command.SLOWER:
                raise RuntimeError("as a bug does")
            if command is Command.FASTER:
                raise SystemExit(7)
"""


def program():
    return Terminal(sys.executable, "-c", PROGRAM)


def test_keys_come_one_by_one_and_without_echo():
    with program() as terminal:
        terminal.wait_for("<ready>")
        terminal.press(b"q s\x1b[Cx\x1bOC")
        terminal.wait_for(r"<PAUSE>\s+<STEP>\s+<STEP>\s+<STEP>")
        terminal.press(b"\x1b[A")
        shown = terminal.wait_for(r"(?s)^(.*)\[ended with 7, usual\]")[1]
        assert shown.split() == ["<FASTER>"]


@pytest.mark.usefixtures("hang_up")
@pytest.mark.parametrize(
    ("number", "code"),
    [(signal.SIGTERM, 128 + signal.SIGTERM), (signal.SIGHUP, 128 + signal.SIGHUP)],
)
def test_a_signal_leaves_the_terminal_as_it_was(number, code):
    with program() as terminal:
        terminal.wait_for("<ready>")
        os.kill(terminal.pid, number)
        terminal.wait_for(rf"\[ended with {code}, usual\]")


def test_ctrl_z_gives_the_terminal_back_and_fg_takes_it_again():
    with program() as terminal:
        terminal.wait_for("<ready>")
        for _ in range(2):
            terminal.press(b"\x1a")
            terminal.wait_for(r"\[stopped, usual\]")
            terminal.press(b"\n")
            terminal.wait_for(r"<stood still for [0-9.e-]+>")
            terminal.press(b" ")
            terminal.wait_for("<PAUSE>")
        terminal.press(b"\x1b[A")
        terminal.wait_for(r"\[ended with 7, usual\]")


def test_without_a_terminal_there_are_no_keys():
    program = (
        "from knee_contact_ros.system.keyboard import Keyboard, has_terminal\n"
        "with Keyboard(print) as keyboard: print(has_terminal(), keyboard.wait_for_keys(0.01))"
    )
    done = subprocess.run(
        [sys.executable, "-c", program],
        input=" ",
        capture_output=True,
        text=True,
        check=True,
        timeout=60,
    )
    assert done.stdout == "False []\n"
