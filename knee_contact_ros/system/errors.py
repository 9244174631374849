"""Errors that a user's input can cause: one printable line that says what is wrong and what is allowed."""

import difflib
from collections.abc import Collection, Sequence

MAX_NAMES = 20
"""Largest number of names that an error lists"""
MAX_FAULTS = 3
"""Largest number of faults in a message"""
MAX_NAME_LENGTH = 100
"""Largest number of characters of a name in a list"""


def printable(text: str) -> str:
    r"""Return a text whose non-printable characters (escape codes, line ends) are escapes such as `\x1b`."""
    if text.isprintable():
        return text
    return "".join(
        character
        if character.isprintable()
        else character.encode("unicode_escape").decode("ascii")
        for character in text
    )


def list_names(names: Sequence[str]) -> str:
    """Join names with commas; a long list is cut, and so is a long name."""
    shown = [
        name if len(name) <= MAX_NAME_LENGTH else f"{name[:MAX_NAME_LENGTH]}..."
        for name in names[:MAX_NAMES]
    ]
    more = f" and {len(names) - MAX_NAMES} more" if len(names) > MAX_NAMES else ""
    return printable(", ".join(shown)) + more


def suggest(name: str, names: Collection[str], otherwise: str = "", cutoff: float = 0.6) -> str:
    """Return a hint for an unknown name: the similar known one, or `otherwise`, or the known or nearest ones."""
    near = difflib.get_close_matches(name, names, n=1, cutoff=cutoff)
    if near or otherwise:
        return f"did you mean {near[0]}?" if near else otherwise
    if len(names) <= MAX_NAMES:
        return f"allowed are {', '.join(names)}"
    nearest = difflib.get_close_matches(name, names, n=3, cutoff=0.0)
    return f"the nearest of {len(names)} are {', '.join(nearest)}"


def join_faults(faults: Collection[str]) -> str:
    """Join the first faults, and the number of the others, in one line of printable characters."""
    more = len(faults) - MAX_FAULTS
    return printable("; ".join(list(faults)[:MAX_FAULTS])) + (
        f"; and {more} more" if more > 0 else ""
    )


class CommandError(Exception):
    """Error whose text is one printable line, whatever foreign names and texts are in it."""

    def __init__(self, text: str) -> None:
        super().__init__(printable(" ".join(text.split())))


class UsageError(CommandError):
    """Bad input. The text names the file, topic or parameter, its value and what is allowed; exit code 2.

    Example:
        >>> from knee_contact_ros import UsageError, load_model
        >>> try:
        ...     load_model({"femur.mass": -1.0})
        ... except UsageError as error:
        ...     print(error)
        parameter femur.mass: -1.0 is not allowed; it should be greater than or equal to 0.0001
    """


class IncompleteError(CommandError):
    """The work is done, but a part of the input is missing. The text says which part; exit code 1."""
