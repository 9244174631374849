"""The errors that a user's input can cause: one line that says what is wrong and what would be right."""

from __future__ import annotations

from knee_contact_ros.system.printable import printable


class ToldError(Exception):
    """Is told in one line, on a terminal or in a log, whatever names and texts of others are in it."""

    def __init__(self, text: str) -> None:
        super().__init__(printable(" ".join(text.split())))


class UsageError(ToldError):
    """Bad input: names the file, topic or parameter, its value and what is allowed. The command exits with code 2."""


class IncompleteError(ToldError):
    """The work is done, but something of the input is missing: says what in one line. The command exits with code 1."""
