"""The one kind of error that a user's input can cause: one line that says what is wrong and what would be right."""

from __future__ import annotations


class UsageError(Exception):
    """Bad input: names the file, topic or parameter, its value and what is allowed. The command exits with code 2."""
