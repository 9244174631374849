"""How late messages were published, and the line that reports it at the end."""

from __future__ import annotations

LATE = 1e-3
"""Delay [s] above which a message counts as late"""
MS = 1e3


class Lateness:
    """Counts published messages, and measures how much later than due they were."""

    def __init__(self) -> None:
        self.messages = 0
        self.late = 0
        self.largest = 0.0
        """Largest delay [s]"""
        self.drift = 0.0
        """Delay [s] of the last message of a pass through the bag, the largest of all passes"""
        self._last = 0.0

    def add(self, seconds: float | None) -> None:
        """Count a message that was `seconds` late; None: a key stepped to it, and it is never late."""
        self.messages += 1
        self._last = seconds or 0.0
        if self._last > LATE:
            self.late += 1
        self.largest = max(self.largest, self._last)

    def end(self) -> None:
        """Note the end of a pass through the bag."""
        self.drift = max(self.drift, self._last)
        self._last = 0.0

    def __str__(self) -> str:
        """Return the report as one line."""
        percent = 100.0 * self.late / max(self.messages, 1)
        return (
            f"{self.messages} messages published, {self.late} ({percent:.3g} %) later than {LATE * MS:g} ms, "
            f"the latest by {self.largest * MS:.2f} ms; drift at the end {self.drift * MS:.2f} ms"
        )
