"""How late messages went out, and what is said about it at the end."""

from __future__ import annotations

LATE = 1e-3
"""[s] from which on a message counts as late"""
MS = 1e3


class Lateness:
    """Counts messages and how much later than due they were."""

    def __init__(self) -> None:
        self.messages = 0
        self.late = 0
        self.largest = 0.0
        """[s]"""
        self.drift = 0.0
        """[s] of the last message of a time through the bag, the largest of all times"""
        self._last = 0.0

    def add(self, seconds: float | None) -> None:
        """Count a message; None: it was called for by a key, and so never late."""
        self.messages += 1
        self._last = seconds or 0.0
        if self._last > LATE:
            self.late += 1
        self.largest = max(self.largest, self._last)

    def end(self) -> None:
        """The bag, or what was played of it, is over."""
        self.drift = max(self.drift, self._last)
        self._last = 0.0

    def __str__(self) -> str:
        """One line."""
        percent = 100.0 * self.late / max(self.messages, 1)
        return (
            f"{self.messages} messages published, {self.late} ({percent:.3g} %) later than {LATE * MS:g} ms, "
            f"the latest by {self.largest * MS:.2f} ms; drift at the end {self.drift * MS:.2f} ms"
        )
