"""Text that came from elsewhere, for a terminal, a log or an error: nothing in it can move a cursor or hide."""

from __future__ import annotations

from collections.abc import Sequence

SHOWN = 20
"""How many names an error lists"""
LONGEST = 100
"""Characters of a name in a list"""


def printable(text: str) -> str:
    r"""The text with every character that is not printed as it is (escape codes, line ends) spelled as in `\x1b`."""
    if text.isprintable():
        return text
    return "".join(
        character if character.isprintable() else character.encode("unicode_escape").decode("ascii")
        for character in text
    )


def listed(names: Sequence[str]) -> str:
    """Names with commas; a long list is cut, and so is a long name."""
    more = f" and {len(names) - SHOWN} more" if len(names) > SHOWN else ""
    return (
        printable(", ".join(name if len(name) <= LONGEST else f"{name[:LONGEST]}..." for name in names[:SHOWN])) + more
    )
