"""What `/diagnostics` says once a second: input rates and ages, refused samples, tick times, recorder and viewer."""

from __future__ import annotations

import time
from collections import Counter
from dataclasses import dataclass, field
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue

from knee_contact_ros.core.types import Contact, Fidelity, Status


@dataclass
class InputMeter:
    """Rate and age of one input stream."""

    received: int = 0
    last: float | None = None
    """Monotonic time of the last message [s]"""
    reported: int = 0

    def count(self) -> None:
        """Note that a message has come."""
        self.received += 1
        self.last = time.monotonic()

    def values(self, period: float) -> dict[str, str]:
        """Rate over the last period [s], age, and total."""
        rate = (self.received - self.reported) / period
        self.reported = self.received
        age = "never" if self.last is None else f"{time.monotonic() - self.last:.3f}"
        return {"received": str(self.received), "rate [Hz]": f"{rate:.1f}", "age [s]": age}


@dataclass
class TickMeter:
    """Ticks, their times and their flags."""

    ticks: int = 0
    flagged: Counter[str] = field(default_factory=Counter)
    fidelities: Counter[str] = field(default_factory=Counter)
    durations: list[float] = field(default_factory=list)
    """Of the ticks since the last report [s]"""

    def count(self, contact: Contact, duration: float) -> None:
        """Note an answer and the time it took [s]."""
        self.ticks += 1
        self.durations.append(duration)
        self.fidelities[Fidelity(contact.fidelity).name] += 1
        for bit in Status:
            if contact.status & bit:
                self.flagged[bit.name or ""] += 1

    def values(self) -> dict[str, str]:
        """Totals, and tick times of the last period."""
        durations, self.durations = sorted(self.durations), []
        values = {"ticks": str(self.ticks)}
        if durations:
            values["tick time median [us]"] = f"{durations[len(durations) // 2] * 1e6:.0f}"
            values["tick time max [us]"] = f"{durations[-1] * 1e6:.0f}"
        for name, count in sorted(self.fidelities.items()):
            values[f"fidelity {name}"] = f"{count} ({100.0 * count / self.ticks:.1f} %)"
        return values | {f"status {name}": str(count) for name, count in self.flagged.items()}


def diagnostic_status(name: str, values: dict[str, str], problem: str = "") -> Any:
    """One entry of the array: a warning if there is a problem."""
    return DiagnosticStatus(
        level=DiagnosticStatus.WARN if problem else DiagnosticStatus.OK,
        name=name,
        message=problem or "ok",
        values=[KeyValue(key=key, value=value) for key, value in values.items()],
    )


def diagnostic_array(stamp: Any, statuses: list[Any]) -> Any:
    """The message."""
    message = DiagnosticArray(status=statuses)
    message.header.stamp = stamp
    return message
