"""Formats of numbers and comparisons."""

from __future__ import annotations

COMPARISON = ("quantity", "paper", "ours", "difference", "why")


def compare(quantity: str, paper: float, ours: float, unit: str, digits: int, why: str) -> list[str]:
    """Row of a comparison; the paper's number keeps its digits."""
    difference = ours - paper
    shown = f"{signed(difference, digits)} {unit}"
    if unit != "%":
        shown += f" ({signed(100.0 * difference / abs(paper), 1)} %)"
    return [quantity, f"{paper:g} {unit}", f"{ours:.{digits}f} {unit}", shown, why]


def signed(value: float, digits: int) -> str:
    """Format a number with its sign, and without one if it rounds to zero."""
    rounded = round(value, digits)
    return f"{rounded:+.{digits}f}" if rounded else f"{0.0:.{digits}f}"


def unprinted(quantity: str, ours: str, why: str) -> list[str]:
    """Row about something that the paper gives no number for."""
    return [quantity, "-", ours, "-", why]


def thousands(value: float, digits: int = 0) -> str:
    """Format a number with thin groups of three digits."""
    return f"{value:,.{digits}f}".replace(",", " ")


def figure(name: str, caption: str) -> str:
    """Format a picture with its caption."""
    return f"![{caption}](images/reproduction_{name}.png)\n\n*{caption}*"
