"""Foreign text for a terminal, a log or an error: control characters in it become visible."""

from __future__ import annotations

from collections.abc import Sequence

SHOWN = 20
"""Largest number of names that an error lists"""
LONGEST = 100
"""Largest number of characters of a name in a list"""


def printable(text: str) -> str:
    r"""Text with every non-printable character (escape codes, line ends) replaced by an escape such as `\x1b`."""
    if text.isprintable():
        return text
    return "".join(
        character if character.isprintable() else character.encode("unicode_escape").decode("ascii")
        for character in text
    )


def listed(names: Sequence[str]) -> str:
    """List of names with commas; a long list is cut, and so is a long name."""
    more = f" and {len(names) - SHOWN} more" if len(names) > SHOWN else ""
    return (
        printable(", ".join(name if len(name) <= LONGEST else f"{name[:LONGEST]}..." for name in names[:SHOWN])) + more
    )
