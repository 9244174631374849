"""Regular work of a session, where it delays no sample: right after an answer, or by a timer while none comes."""

import heapq
import time
from collections.abc import Callable, Sequence

LONGEST_PAUSE = 2e-4
"""Time [s] of work after an answer from which the rest waits for the next answer"""


class RegularWork:
    """Functions that are called regularly, each with its period."""

    def __init__(self, calls: Sequence[tuple[float, Callable[[], object]]]) -> None:
        """Begin the periods [s] of the functions now."""
        now = time.perf_counter()
        self._due = [
            (now + period, number, period, act) for number, (period, act) in enumerate(calls)
        ]  # a heap
        heapq.heapify(self._due)

    def do_due(self, by: float, until: float) -> None:
        """Call what is due by a time [s], what has waited longest first; after a time `until` nothing more begins."""
        while self._due[0][0] <= by:
            now = time.perf_counter()
            _, number, period, act = self._due[0]
            heapq.heapreplace(self._due, (now + period, number, period, act))
            act()
            if time.perf_counter() >= until:
                return
