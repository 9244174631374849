"""The figures of the page, in colours that colour-blind readers tell apart."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import matplotlib as mpl
import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from benchmarks.gait import BODY_WEIGHT
from knee_contact_ros.lab.report.figures import COMPUTED
from studies.reproduction.osteoarthritis import (
    CARTILAGE,
    LAWS,
    break_even,
    largest_force,
    loss_for_paper,
)
from studies.reproduction.scenes import (
    ARTHRITIC,
    CYCLE,
    FINE,
    HEALTHY,
    MECHANISMS,
    MM,
    MRI,
    at,
    body_weights,
    gait,
    led_run,
    phases,
    run,
    second_stance,
    within,
)

mpl.use("Agg")


BLUE, ORANGE, GREEN, VERMILLION, PURPLE, GREY = (
    "#0072B2",
    "#E69F00",
    "#009E73",
    "#D55E00",
    "#CC79A7",
    "#666666",
)
SIZE: dict[Any, Any] = {
    "font.size": 9.5,
    "axes.titlesize": 9.5,
    "legend.fontsize": 8.5,
    "axes.grid": True,
    "grid.alpha": 0.3,
}
WIDTH, DPI = 7.5, 150
MARKERS = ("v", "s", "o", "D")
"""Markers of the four phases, in their order"""


def panels(
    height: float, rows: int = 1, columns: int = 1, **options: Any
) -> tuple[Figure, list[Axes]]:
    """A figure [inches] and its panels in reading order."""
    plt.rcParams.update(SIZE)
    figure, axes = plt.subplots(
        rows, columns, figsize=(WIDTH, height), squeeze=False, layout="constrained", **options
    )
    return figure, list(axes.flat)


def heel_strike(axes: Axes, time: float, label: str = "") -> None:
    """Draw a vertical line at a heel strike [s]."""
    axes.axvline(time, color=GREY, linewidth=1.0, linestyle=":", label=label or None)


def store(figure: Figure, folder: Path, name: str) -> None:
    """Write a figure as reproduction_NAME.png."""
    folder.mkdir(parents=True, exist_ok=True)
    figure.savefig(folder / f"reproduction_{name}.png", dpi=DPI, metadata={"Software": None})
    plt.close(figure)


TIME = "time [s]"


def force() -> Figure:
    """Draw the contact force of sphere and curve, and their difference."""
    figure, (top, bottom) = panels(5.0, 2, sharex=True, height_ratios=(2.4, 1.0))
    time, _, load = gait("right")
    sphere, curve = run(HEALTHY).contact_force, run(HEALTHY, MRI).contact_force
    for each, moment in zip(COMPUTED, second_stance(), strict=True):
        for center in (moment, moment - (CYCLE[1] - CYCLE[0])):
            name = each.what if (each, center) == (COMPUTED[0], moment) else None
            around = (center - 0.09, min(center + 0.09, time[-1]))
            top.fill_between(
                around,
                each.lowest,
                each.highest,
                color=ORANGE,
                alpha=0.35,
                linewidth=0,
                label=name,
            )
    top.plot(time, load / BODY_WEIGHT, color=GREY, linewidth=4.0, alpha=0.4, label="load")
    top.plot(time, sphere / BODY_WEIGHT, color=BLUE, label="sphere")
    top.plot(time, curve / BODY_WEIGHT, color=VERMILLION, linestyle="--", label="fitted curve")
    for moment, each in zip(second_stance(), COMPUTED, strict=True):
        value = body_weights(at(moment, load))
        top.annotate(
            f"{value:.2f} BW",
            (moment, each.highest),
            (0, 3),
            textcoords="offset points",
            ha="center",
        )
    bottom.plot(time[1:], (curve - sphere)[1:], color=PURPLE)
    _strikes(top, bottom)
    top.set(ylabel="contact force [BW]", ylim=(0.0, 2.95))
    top.legend(ncols=3, loc="upper center")
    bottom.set(ylabel="curve - sphere [N]", xlabel=TIME)
    return figure


def depth() -> Figure:
    """Draw depth, femoral height and the difference in depth."""
    figure, axes = panels(6.4, 3, sharex=True, height_ratios=(1.5, 1.5, 1.0))
    time = gait("right")[0]
    sphere, curve = run(HEALTHY), run(HEALTHY, MRI)
    for series, colour, style, name in (
        (sphere, BLUE, "-", "sphere"),
        (curve, VERMILLION, "--", "fitted curve"),
    ):
        axes[0].plot(
            time, MM * series.penetration_depth, color=colour, linestyle=style, label=name
        )
        height = series.femoral_height - at(CYCLE[1], series.femoral_height)
        axes[1].plot(time, MM * height, color=colour, linestyle=style, label=name)
    axes[2].plot(
        time[1:], 1e6 * (curve.penetration_depth - sphere.penetration_depth)[1:], color=PURPLE
    )
    for value, where, line in (
        (0.795, "abstract", (0, (6, 2, 1, 2))),
        (0.705, "text", (0, (8, 3))),
    ):
        axes[0].axhline(
            value,
            color="black",
            linestyle=line,
            linewidth=1.0,
            label=f"paper, {where}: {value:g} mm",
        )
    _strikes(*axes)
    axes[0].set(ylabel="penetration depth [mm]", ylim=(0.0, 1.15))
    axes[0].legend(ncols=3, loc="upper center")
    axes[1].set(ylabel="femoral height from\nheel strike [mm]")
    axes[1].legend(loc="lower right")
    axes[2].set(ylabel="depth, curve\n- sphere [µm]", xlabel=TIME)
    return figure


def contact_points() -> Figure:
    """Draw the contact point over time and over flexion."""
    figure, (left, right) = panels(4.6, 1, 2, sharey=True)
    time, angle, _ = gait("right")
    flexed = np.argsort(angle)
    for (name, changes), colour in zip(MECHANISMS.items(), (VERMILLION, BLUE, GREEN), strict=True):
        for files, style in (((HEALTHY, MRI), "-"), ((HEALTHY,), "--")):
            x = MM * run(*files, changes=changes).contact_point.x
            femur = "fitted curve" if MRI in files else "sphere"
            left.plot(time, x, color=colour, linestyle=style, label=f"{femur}, {name}")
            right.plot(np.degrees(angle[flexed]), x[flexed], color=colour, linestyle=style)
            for marker, moment in zip(MARKERS, phases(), strict=True):
                for axes, where in (
                    (left, moment.time),
                    (right, np.degrees(at(moment.time, angle))),
                ):
                    axes.plot(
                        where,
                        at(moment.time, x),
                        marker,
                        color=colour,
                        markersize=6,
                        markeredgecolor="black",
                    )
    for marker, moment in zip(MARKERS, phases(), strict=True):
        right.plot([], [], marker, color="white", markeredgecolor="black", label=moment.name)
    left.set(xlabel=TIME, ylabel="contact point x, anterior positive [mm]", ylim=(-4.5, 8.5))
    right.legend(ncols=2, loc="upper center")
    right.set(xlabel="flexion angle [°]")
    figure.legend(*left.get_legend_handles_labels(), ncols=3, loc="outside upper center")
    return figure


def osteoarthritis() -> Figure:
    """Draw force and depth over time, and the peak force over the lost cartilage."""
    figure, (first, second, third) = panels(7.6, 3, height_ratios=(1.3, 1.3, 1.2))
    time = gait("right")[0]
    knees = (
        (run(HEALTHY, MRI), BLUE, "-", "healthy, load prescribed"),
        (run(ARTHRITIC, MRI), VERMILLION, "--", "osteoarthritis, load prescribed"),
        (
            led_run(loss_for_paper() / MM),
            GREEN,
            "-.",
            f"osteoarthritis, path prescribed, {loss_for_paper():.3f} mm lost",
        ),
    )
    for series, colour, style, name in knees:
        first.plot(
            time,
            body_weights(1.0) * series.contact_force,
            color=colour,
            linestyle=style,
            label=name,
        )
        second.plot(time, MM * series.penetration_depth, color=colour, linestyle=style)
    second.axhline(
        0.521,
        color="black",
        linewidth=1.0,
        linestyle=(0, (8, 3)),
        label="paper, osteoarthritis: 0.521 mm",
    )
    _strikes(first, second)
    first.set(ylabel="contact force [BW]", ylim=(0.0, 3.2), title="(a)", xlabel=TIME)
    second.set(ylabel="penetration depth [mm]", ylim=(0.0, 0.98), title="(b)", xlabel=TIME)
    first.legend(loc="upper center", ncols=2)
    second.legend(loc="upper center", ncols=2)
    _losses(third)
    return figure


def _losses(axes: Axes) -> None:
    bare = MM * float(run(HEALTHY, MRI).penetration_depth.max()) - CARTILAGE
    lost = sorted([*np.linspace(0.0, 0.4, 21).tolist(), bare])
    axes.semilogy(
        lost, [largest_force(value) for value in lost], color=GREEN, label="path prescribed"
    )
    axes.axhline(
        body_weights(float(run(HEALTHY, MRI).contact_force.max())), color=BLUE, label="healthy"
    )
    for value, marker, name in (
        (break_even(), "o", "healthy peak force"),
        (loss_for_paper(), "D", "paper's 0.521 mm"),
    ):
        axes.plot(
            value, largest_force(value), marker, color="white", markeredgecolor="black", label=name
        )
    axes.set(
        xlabel="cartilage lost [mm]", ylabel="largest force [BW]", title="(c)", ylim=(0.4, 30.0)
    )
    axes.set_yticks([0.5, 1, 2, 5, 10, 20], ["0.5", "1", "2", "5", "10", "20"])
    axes.minorticks_off()
    axes.legend(loc="upper right")


def ringing() -> Figure:
    """Draw force less load, and depth, with both forms of the law."""
    figure, (top, bottom) = panels(5.0, 2, sharex=True)
    time, _, load = gait("right", FINE)
    part = within(1.45, 2.2, FINE)
    for (name, changes), colour, width in zip(
        LAWS.items(), (VERMILLION, BLUE), (0.9, 1.4), strict=True
    ):
        series = run(ARTHRITIC, changes=changes, step=FINE)
        top.plot(
            time[part],
            (series.contact_force - load)[part],
            color=colour,
            linewidth=width,
            label=name,
        )
        bottom.plot(
            time[part],
            MM * series.penetration_depth[part],
            color=colour,
            linewidth=width,
            label=name,
        )
    bottom.axhline(0.5, color="black", linewidth=1.0, linestyle=":", label="second layer begins")
    _strikes(top, bottom, times=(CYCLE[1],))
    top.set(ylabel="contact force - load [N]", ylim=(-62.0, 92.0))
    top.legend(loc="upper right", ncols=3)
    bottom.set(ylabel="penetration depth [mm]", xlabel=TIME)
    bottom.legend(loc="lower right")
    return figure


def _strikes(*axes: Axes, times: tuple[float, ...] = CYCLE) -> None:
    for each in axes:
        for time in times:
            heel_strike(each, time, "heel strike" if time == times[-1] else "")


FIGURES: dict[str, Callable[[], Figure]] = {
    "force": force,
    "depth": depth,
    "contact_points": contact_points,
    "osteoarthritis": osteoarthritis,
    "ringing": ringing,
}


def draw(folder: Path) -> None:
    """Write all figures into a folder."""
    for name, make in FIGURES.items():
        store(make(), folder, name)
