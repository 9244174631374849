"""Results of a study as tables."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from benchmarks.report import Section
from studies.honesty.scenes import FAMILIES, WIDE
from studies.honesty.study import BadTick, Key, Outcome
from studies.honesty.tally import Quantity, Tally, percentile

TITLE = "How honest the error estimates are"
TEXT = (
    "Random scenes of 300 ticks: in two of three any of the nine laws over wide ranges (exponent 1 to 3, stiffness "
    "1e6 to 1e11 N/m^1.5 or as stiff at 0.5 mm, damping 0 to 3e5 N s/m, mass 0.2 g to 30 kg, layers of 0.03 to 1 mm, "
    "ticks of 0.2 to 10 ms, half of the series irregular, slopes up to 0.3 rad, ellipses that turn, in 15 % tension "
    "allowed) under loads that press, pull, jump, wander, or are those of gait and running; the others are the "
    "shipped healthy and osteoarthritic constants, each varied by up to 30 %, under gait, gait with lift-offs and "
    "running. The error is that of the signed depth, or of the contact force, against `studies/reference`, which "
    "shares no code with the model and solves every scene twice: a tick is known where the two differ by less than 2 "
    "% of the model's error (or of 1e-12 m; 1e-7 N or 1e-10 of the load). Covered: share of known ticks whose error "
    "is within its estimate; errors below 1e-12 m (1e-7 N) are rounding and count as covered in the first of the two "
    "columns, and not at all in the second. Said right and wrong: known ticks with status OK and an error beyond the "
    "tolerance, and all with status OK and an estimate that is not finite. OK beyond its estimate: status OK though "
    "the run's own estimate is beyond the tolerance. Estimate over error: median (5 %, 95 %) of known ticks above "
    "rounding."
)
COMMON = ("ticks", "known", "covered", "of errors above rounding", "said right and wrong", "in runs")
RATIOS = ("estimate over error in contact", "apart", "where status is OK")
Rows = list[list[str]]


def _share(part: int, whole: int) -> str:
    return f"{100 * part / whole:.2f} %" if whole else "-"


def _ratios(histogram: Any) -> str:
    if not histogram.sum():
        return "-"
    middle, low, high = (percentile(histogram, percent) for percent in (50, 5, 95))
    return f"{middle:.3g} ({low:.2g}, {high:.3g})"


def _all_ratios(quantity: Quantity) -> list[str]:
    return [_ratios(histogram) for histogram in (quantity.contact, quantity.apart, quantity.right)]


def _common(tally: Tally, quantity: Quantity) -> list[str]:
    return [
        str(tally.ticks), _share(quantity.known, tally.ticks), _share(quantity.covered, quantity.known),
        _share(quantity.covered_large, quantity.large), str(quantity.wrong), str(quantity.wrong_runs),
    ]  # fmt: skip


def _cost(tally: Tally) -> list[str]:
    return [
        str(tally.claimed), _share(tally.flagged, tally.ticks), f"{tally.evaluations / tally.ticks:.1f}",
        _share(tally.static, tally.ticks),
    ]  # fmt: skip


COST = ("OK beyond its estimate", "flagged", "evaluations per tick", "answered statically")


def _grouped(outcome: Outcome, names: Callable[[Key], tuple[str, ...] | None]) -> dict[tuple[str, ...], Tally]:
    """Tallies added up by a name of their keys; those without one are left out."""
    groups: dict[tuple[str, ...], Tally] = {}
    for key, tally in outcome.tallies.items():
        group = names(key)
        if group is not None:
            groups.setdefault(group, Tally()).add(tally)
    return groups


def _tolerances(key: Key) -> str:
    force = f", {key.force_tolerance:g} N" if key.force_tolerance else ""
    return f"{key.tolerance:.0e} m{force}"


def _depth_rows(groups: dict[tuple[str, ...], Tally]) -> Rows:
    return [
        [*group, *_common(tally, tally.depth), *_all_ratios(tally.depth), *_cost(tally)]
        for group, tally in groups.items()
    ]


def _force_rows(groups: dict[tuple[str, ...], Tally]) -> Rows:
    return [
        [*group, *_common(tally, tally.force), *_all_ratios(tally.force)]
        for group, tally in groups.items()
        if tally.force.known
    ]


def _bad_rows(bad: list[BadTick]) -> Rows:
    return [
        [
            f"{one.severity:.2g}", one.quantity, str(one.seed), str(one.tick), one.key.law, one.key.loads,
            one.key.level, _tolerances(one.key), f"{one.error:.2e}", f"{one.estimate:.2e}",
            "OK" if one.said_right else "flagged",
        ]
        for one in bad
    ]  # fmt: skip


BAD = ("times", "of", "scene", "tick", "law", "load", "level", "tolerance", "error", "estimate", "status")


def sections(outcome: Outcome) -> list[Section]:
    """All sections of the page."""
    families = {WIDE: "any law"} | {family: family for family in FAMILIES if family != WIDE}
    everywhere = _grouped(outcome, lambda key: (key.level, _tolerances(key)))
    by_family = _grouped(outcome, lambda key: (families[key.family], key.level, _tolerances(key)))
    both = _grouped(outcome, lambda key: None if key.family == WIDE else ("both", key.level, _tolerances(key)))
    by_law = _grouped(outcome, lambda key: (key.law, key.level, _tolerances(key)))
    loads = _grouped(
        outcome,
        lambda key: (
            (families[key.family], key.loads, _tolerances(key))
            if key.level == "dynamic" and key.family != WIDE
            else None
        ),
    )
    header, force = (*COMMON, *RATIOS, *COST), (*COMMON, *RATIOS)
    where = ("level", "tolerance")
    return [
        Section("", TEXT, (*where, *header), _depth_rows(everywhere)),
        Section("Contact force", "", (*where, *force), _force_rows(everywhere)),
        Section("Plausible knees", "", ("knee", *where, *header), _depth_rows(by_family | both)),
        Section("Plausible knees at dynamic, by load", "", ("knee", "load", "tolerance", *header), _depth_rows(loads)),
        Section("By law", "", ("law", *where, *header), _depth_rows(by_law)),
        Section("Contact force by law", "", ("law", *where, *force), _force_rows(by_law)),
        Section("Said right and wrong: the worst", _SHOW, BAD, _bad_rows(outcome.wrong)),
        Section("Not covered: the worst", _SHOW, BAD, _bad_rows(outcome.uncovered)),
    ]


_SHOW = "`python -m studies.honesty --show SCENE` prints a scene. One tick of a scene and level."
