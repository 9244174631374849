"""Numbers with units, two digits each."""

from __future__ import annotations

from studies.choosing.errors import Apart

PREFIXES = ((1e-3, "mm"), (1e-6, "µm"), (1e-9, "nm"), (1e-12, "pm"))
ROUNDING = 1e-15
"""Length [m] below which a difference is rounding"""


def length(metres: float) -> str:
    """Format a length [m] as 19 nm; 0 where it is rounding."""
    if abs(metres) < ROUNDING:
        return "0"
    size, unit = next((each for each in PREFIXES if abs(metres) >= 0.9995 * each[0]), PREFIXES[-1])
    return f"{two_digits(metres / size)} {unit}"


def force(newtons: float) -> str:
    """Format a force [N] as 0.05 N; 0 below what the reference resolves."""
    return "0" if abs(newtons) < 1e-6 else f"{two_digits(newtons)} N"


def microseconds(value: float) -> str:
    """Format a time [µs] as 0.31 µs."""
    return f"{two_digits(value)} µs"


def differences(found: Apart) -> str:
    """Format differences of depth, force and contact point."""
    return f"{length(found.depth)}, {force(found.force)}, {length(found.x)}"


def two_digits(value: float) -> str:
    """Format two digits, without a power of ten where numbers are small enough."""
    rounded = float(f"{value:.2g}")
    return f"{rounded:.0f}" if abs(rounded) >= 10.0 else f"{rounded:.2g}"


def power(value: float) -> str:
    """Format a power of ten as 1e-6."""
    return f"{value:.0e}".replace("e-0", "e-")
