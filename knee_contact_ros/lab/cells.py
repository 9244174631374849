"""What a cell of a text table says: a number in any country's form, a missing one, or a time of day."""

import math
import re
from datetime import date

NOT_A_NUMBER = re.compile(
    r"[-+]?(?:nan(?:\(\w*\))?|\d\.#\w+)|n/?a|#n/?a|#div/0!|null|none|-+", re.IGNORECASE
)
"""Texts for a missing number, or on Windows infinity: nan, -nan(ind), 1.#QNAN, -1.#IND, NA, #N/A, null, -"""
GROUPED = re.compile(r"[-+]?[1-9]\d{0,2}(?:(?:\.\d{3})+(?:,\d*)?|(?:,\d{3})+(?:\.\d*)?)")
"""Numbers that may have a thousands mark: in 1.760 and 1,760 it may also be a decimal mark; 1.760,5 has one"""
TIME_OF_DAY = re.compile(
    r"(?:(\d{4})[-/](\d\d?)[-/](\d\d?)[ T]+|([^:]*?)[ ,]+)?(?:(\d+):)?([0-5]?\d):([0-5]?\d(?:[.,]\d+|:\d{3})?)"
    r"(?: *([ap])\.?m\.?)?(?: *(Z|UTC|GMT|[-+]\d\d(?::?\d\d)?))?",
    re.IGNORECASE,
)
"""A time of day: an ISO date or another one, hours, minutes, seconds, am or pm, zone; only minutes and seconds are
required"""
DAY = 86_400.0
"""Length of a day [s]"""


class Clock:
    """Reads times of day, also across midnight; times with a zone become UTC."""

    def __init__(self) -> None:
        """Begin before the first time."""
        self.day: int | str | None = None
        """Day of the first row: the day number of an ISO date, the text of another one, empty without a date"""
        self._last = 0.0
        self._midnights = 0

    def seconds(self, cell: str) -> float:
        """Return the time [s] since the midnight before the first row; raise a ValueError if a cell has none."""
        match = TIME_OF_DAY.fullmatch(cell)
        if match is None:
            raise ValueError
        year, month, day, other, hours, minutes, seconds, half, zone = match.groups()
        hour = int(hours or 0)
        if half:
            if not (hours and 1 <= hour <= 12):
                raise ValueError
            hour = hour % 12 + (12 if half in "pP" else 0)
        at = 3600.0 * hour + 60.0 * int(minutes) + float(re.sub("[,:]", ".", seconds))
        if zone and zone[0] in "+-":
            ahead = 3600.0 * int(zone[1:3]) + 60.0 * int(zone[3:].strip(":") or 0)
            at -= ahead if zone[0] == "+" else -ahead
        today = date(int(year), int(month), int(day)).toordinal() if year else 0
        if self.day is None:
            self.day = today or other or ""
        if year and isinstance(self.day, int):
            return DAY * (today - self.day) + at
        if self._last - at > DAY / 2.0:
            self._midnights += 1
        self._last = at
        return DAY * self._midnights + at


def parse_number(cell: str, decimal: str, thousands: bool) -> float:
    """Return the number in a cell, NaN if it is empty or says that it is missing.

    Args:
        cell: Text of the cell.
        decimal: Decimal mark; empty: either, and in a cell with both the last one.
        thousands: Whether the other mark may be a thousands mark, where the digits are grouped like that.

    Raises:
        ValueError: the cell has any other text.
    """
    if not cell or NOT_A_NUMBER.fullmatch(cell):
        return math.nan
    if "_" in cell:  # which Python would take
        raise ValueError
    mark = decimal or ("," if cell.rfind(",") > cell.rfind(".") else ".")
    other = "." if mark == "," else ","
    if other in cell:
        ahead = mark in cell and cell.find(mark) < cell.find(other)
        if ahead or not thousands or not GROUPED.fullmatch(cell):
            raise ValueError
        cell = cell.replace(other, "")
    return float(cell.replace(mark, ".", 1))


def is_number(text: str) -> bool:
    """Return whether a text is a number, with a decimal point or comma."""
    try:
        float(text.replace(",", ".", 1))
    except ValueError:
        return False
    return True
