"""Errors that a user's input can cause: one line that says what is wrong and what would be right."""

from __future__ import annotations

from knee_contact_ros.system.printable import printable


class ToldError(Exception):
    """Error whose text is one printable line, whatever foreign names and texts are in it."""

    def __init__(self, text: str) -> None:
        super().__init__(printable(" ".join(text.split())))


class UsageError(ToldError):
    """Bad input. The text names the file, topic or parameter, its value and what is allowed; exit code 2."""


class IncompleteError(ToldError):
    """The work is done, but a part of the input is missing. The text says which part; exit code 1."""
