"""The errors that a user's input can cause: one line that says what is wrong and what would be right."""

from __future__ import annotations


class UsageError(Exception):
    """Bad input: names the file, topic or parameter, its value and what is allowed. The command exits with code 2."""


class IncompleteError(Exception):
    """The work is done, but something of the input is missing: says what in one line. The command exits with code 1."""
