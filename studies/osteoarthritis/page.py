"""docs/osteoarthritis-study.md: `page.txt` with its numbers, which are named there as here."""

from __future__ import annotations

from pathlib import Path
from string import Template

import numpy as np
from tabulate import tabulate

from benchmarks.gait import BODY_WEIGHT
from studies.osteoarthritis.findings import Count, Findings, Range
from studies.osteoarthritis.knees import (
    FIRST,
    LAYER,
    MM,
    SECOND,
    SHIPPED,
    STUDY,
    Floats,
    Knees,
    along,
    equal_second,
    needed_depth,
    turning,
)

PAGE = Path(__file__).with_name("page.txt")
PAPER_DEPTH = 0.521e-3
"""Depth of the paper [m]"""
SHIPPED_KNEE = {LAYER: np.array([SHIPPED.layer_depth]), SECOND: np.array([SHIPPED.stiffness_2])}
CHOSEN = ((0.25, 15), (0.5, 15), (0.5, 8), (0.5, 5), (0.5, 0), (0.7, 15), (0.7, 5), (1.0, 15), (3.0, 15))
"""Layers [mm] and places of K₂ in the table"""
HEADER = (
    "layer h [mm]", "K₂ / K₁", "load given: peak force [BW]", "peak depth [mm]", "on the second layer [s]",
    "peak pressure [MPa]", "height given: peak force [BW]", "of healthy", "turning rise [mm]",
)  # fmt: skip


def text(knees: Knees, found: Findings, machine: str) -> str:
    """Text of the whole page."""
    numbers = {"machine": machine, "study": STUDY.read_text(encoding="utf-8").strip(), "table": _table(knees)}
    numbers |= _of_the_grid(knees) | _of_the_load(found) | _of_the_height(knees, found) | _of_the_loss(knees)
    return Template(PAGE.read_text(encoding="utf-8")).substitute(numbers | _of_checks(found))


def _of_the_grid(knees: Knees) -> dict[str, str]:
    grid, size = knees.grid, knees.forced.size
    shares, layers, seconds = grid.shape
    return {
        "size": _grouped(2 * size), "half": _grouped(size), "seconds": f"{knees.processor:.0f}",
        "least_layer": f"{MM * grid.layers[0]:g}", "most_layer": f"{MM * grid.layers[-1]:g}", "layers": str(layers),
        "least_second": f"{grid.seconds[0] / FIRST:.2f}", "most_second": f"{grid.seconds[-1] / FIRST:.0f}",
        "second_number": str(seconds), "bone": f"{SHIPPED.stiffness_2 / FIRST:.1f}", "shares": str(shares),
        "least_share": f"{grid.shares[0]:g}", "most_share": f"{grid.shares[-1]:g}",
        "neighbours": _grouped(shares * layers * (seconds - 1)),
    }  # fmt: skip


def _of_the_load(found: Findings) -> dict[str, str]:
    most = max(found.momentum, key=lambda one: abs(one.excess))
    elastic = [f"{forced:.2f} ({MM * layer:g} mm, K₂ = {second / FIRST:.3g} K₁)"
               for layer, second, forced, _ in found.elastic]  # fmt: skip
    return {
        "forced_counts": _counts(found.forced), "forced_range": _ends(found.forced_range),
        "forced_drops": str(found.forced.drops), "lowest": f"{100 * (1 - found.forced_range.least):.1f}",
        "momentum_number": str(len(found.momentum)), "excess": f"{most.excess:.3f}", "gained": f"{most.gained:.3f}",
        "impulse": f"{most.load:.0f}", "impulses": _percents(found.impulses),
        "damped_range": _ends(found.damped_range), "damped_impulses": _percents(found.damped_impulses),
        "elastic": ", ".join(elastic),
    }  # fmt: skip


def _of_the_height(knees: Knees, found: Findings) -> dict[str, str]:
    first, last = (float(knees.healthy.peak_depth[place]) for place in (0, -1))
    layers = np.array([0.25e-3, SHIPPED.layer_depth, 0.7e-3])
    limits: Floats = equal_second(layers, first) / FIRST
    told = [f"{limit:.1f} K₁ for {MM * layer:g} mm" for layer, limit in zip(layers, limits, strict=True)]
    shipped = along(knees.paths[0], SHIPPED_KNEE)
    return {
        "led_counts": _counts(found.led), "led_range": _ends(found.led_range),
        "led_least": f"{found.led_range.least:.2f}", "led_most": f"{found.led_range.most:.0f}",
        "stiffer": _none(found.stiffer), "depth_first": f"{MM * first:.3f}", "depth_last": f"{MM * last:.3f}",
        "limits": ", ".join(told), "equal_shipped": f"{limits[1]:.1f}", "reached": _grouped(found.reached),
        "right": _grouped(found.reached - found.beside), "beside": str(found.beside),
        "beside_most": f"{100 * found.beside_most:.2f}", "unreached": _ends(found.unreached),
        "times": f"{float(shipped.peak_force[0] / knees.healthy.peak_force[0]):.1f}",
        "pressure": f"{1e-9 * knees.led.peak_pressure.max():.1f}",
        "softer": " to ".join(
            f"{SHIPPED.stiffness_2 / FIRST / limits[place]:.0f} ({MM * layers[place]:g} mm)" for place in (-1, 0)
        ),
        "near": f"{1e6 * first * (1.5 * FIRST / SHIPPED.stiffness_2) ** 2:.1f}",
    }  # fmt: skip


def _of_the_loss(knees: Knees) -> dict[str, str]:
    force, depth = float(knees.healthy.peak_force[0]), float(knees.healthy.peak_depth[0])
    needed = needed_depth(SHIPPED_KNEE[LAYER], SHIPPED_KNEE[SECOND], np.array([force]))
    lost, last = (turning(knees, SHIPPED.layer_depth, SHIPPED.stiffness_2, place) for place in (0, -1))
    at = [
        float(along(knees.paths[0], SHIPPED_KNEE, rise).peak_force[0]) / force for rise in (lost, depth - PAPER_DEPTH)
    ]
    off = np.abs(knees.forced.peak_depth[0] - PAPER_DEPTH)
    layer, second = np.unravel_index(int(np.argmin(off)), off.shape)
    return {
        "needed": f"{MM * float(needed[0]):.3f}", "turning_first": f"{MM * lost:.3f}",
        "turning_last": f"{MM * last:.3f}", "at_turning": f"{at[0]:.3f}", "at_paper": f"{at[1]:.2f}",
        "paper_loss": f"{MM * (depth - PAPER_DEPTH):.3f}", "near_layer": f"{MM * knees.grid.layers[layer]:g}",
        "near_second": f"{knees.grid.seconds[second] / FIRST:.3g}",
        "near_depth": f"{MM * float(knees.forced.peak_depth[0, layer, second]):.3f}",
    }  # fmt: skip


def _of_checks(found: Findings) -> dict[str, str]:
    return {
        "alone": str(found.alone), "different": _none(found.different), "judged": str(len(found.judged)),
        "judged_depth": f"{1e9 * max(one.depth for one in found.judged):.2f}",
        "judged_force": f"{max(one.force for one in found.judged):.3f}", "flagged": _grouped(found.flagged),
        "ticks": _grouped(found.ticks), "force_bound": f"{found.force_bound:.2f}",
    }  # fmt: skip


def _table(knees: Knees) -> str:
    """Table of some knees at the first share under both drives."""
    healthy = knees.healthy[0]
    peak = f"{healthy.peak_force / BODY_WEIGHT:.3f}"
    rows = [["healthy", "", peak, f"{MM * healthy.peak_depth:.3f}", "", f"{1e-6 * healthy.peak_pressure:.1f}", peak,
             "1.00", ""]]  # fmt: skip
    for layer, asked in CHOSEN:
        row = int(np.argmin(np.abs(MM * knees.grid.layers - layer)))
        place = min(asked, len(knees.grid.seconds) - 1)
        forced, led, second = knees.forced[0, row, place], knees.led[0, row, place], float(knees.grid.seconds[place])
        rows.append([
            f"{MM * knees.grid.layers[row]:.2f}", f"{second / FIRST:.3g}", f"{forced.peak_force / BODY_WEIGHT:.3f}",
            f"{MM * forced.peak_depth:.3f}", f"{forced.bone_time:.2f}", f"{1e-6 * forced.peak_pressure:.1f}",
            f"{led.peak_force / BODY_WEIGHT:.3f}", f"{led.peak_force / healthy.peak_force:.2f}",
            f"{round(MM * turning(knees, float(knees.grid.layers[row]), second), 3) + 0.0:+.3f}",
        ])  # fmt: skip
    return str(tabulate(rows, HEADER, tablefmt="pipe", disable_numparse=True))


def _counts(count: Count) -> str:
    return " / ".join(_grouped(each) for each in count)


def _ends(ends: Range) -> str:
    least, most = (f"{end:.3f}" if end < 10 else f"{end:.0f}" for end in ends)
    return least if least == most else f"{least} to {most}"


def _percents(ends: Range) -> str:
    return f"{100 * ends.least:.2f} to {100 * ends.most:.2f} %"


def _grouped(number: int) -> str:
    return f"{number:,}".replace(",", " ")


def _none(number: int) -> str:
    return str(number) if number else "none"
