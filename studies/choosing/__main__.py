"""What level, tolerance and geometry cost and leave out, beside what the inputs leave open.

python -m studies.choosing [--page FILE] [--data FILE] [--picture FILE]

Puts tables and picture into the measured part of docs/studies/choosing.md. `knee-contact trade` measures levels and
tolerances on a bag and knee of one's own, against the model itself; here other code judges.
"""

from __future__ import annotations

import csv
import math
import os
import time
from collections.abc import Callable, Sequence
from itertools import groupby
from pathlib import Path
from typing import Any, NamedTuple

import click
import numpy as np

from benchmarks.report import machine, table
from knee_contact_ros import load_model
from knee_contact_ros.model.types import Status
from studies.choosing.scenes import (
    CIRCLE,
    COARSER,
    CONFIG,
    MRI_FEMUR,
    MRI_KNEE,
    Answer,
    Apart,
    Geometry,
    Scene,
    answer_of,
    apart,
    exact,
    geometries,
    scenes,
)

LEVELS = ("quasi_static", "dynamic")
TOLERANCES = (1e-4, 1e-5, 1e-6, 1e-8)
DEFAULT_TOLERANCE = 1e-6
TURNS = 9
"""How often a run is timed; the quickest counts"""
BEGIN, END = (
    "<!-- made by python -m studies.choosing: begin -->",
    "<!-- made by python -m studies.choosing: end -->",
)
"""Lines around the measured part of the page"""


class Row(NamedTuple):
    """Error and cost of one geometry at one level and tolerance on one scene."""

    geometry: str
    level: str
    tolerance: float
    """[m]"""
    scene: str
    error: Apart
    """Error against the same geometry solved exactly"""
    flagged: float
    """Share of the ticks flagged NOT_CONVERGED"""
    wrong: int
    """Number of unflagged ticks whose depth is off by more than the tolerance"""
    ticks: int
    microseconds: float
    """Processor time per tick"""


class Left(NamedTuple):
    """Error of a simpler geometry on a scene, and how well that is known."""

    geometry: str
    scene: str
    error: Apart
    """Difference of the exact solution from that of the measured knee"""
    own: Apart
    """Upper bound of the reference's own error"""


class Change(NamedTuple):
    """A change of an input that is not well known."""

    name: str
    why: str
    parameters: dict[str, float]
    """Values that change"""
    load: float = 1.0
    """Factor of the load"""
    angle: float = 0.0
    """Angle [rad] that is added to the flexion angle"""
    base: str = "healthy"


class Effect(NamedTuple):
    """Effect of a change on a scene: of the largest depth and force, in per cent too, and at the worst tick."""

    change: Change
    scene: str
    depth: float
    """[m]"""
    depth_percent: float
    force: float
    """[N]"""
    force_percent: float
    worst: Apart


class Study(NamedTuple):
    """All that the page shows."""

    scenes: list[Scene]
    rows: list[Row]
    left: list[Left]
    effects: list[Effect]


def changes() -> list[Change]:
    """List the changes of inputs."""
    stiffness, layer = 7.905694e7, 5e-4
    return [
        Change(
            "medial share 0.5 → 0.7", "in vivo 0.6 to 0.8 of the whole load", {}, load=0.7 / 0.5
        ),
        Change(
            "body mass + 10 %",
            "load and femur in proportion",
            {"femur.mass": 1.1 * 9.3014},
            load=1.1,
        ),
        Change("stiffness − 20 %", "", {"contact.stiffness": 0.8 * stiffness}),
        Change("stiffness + 20 %", "", {"contact.stiffness": 1.2 * stiffness}),
        Change(
            "femoral size − 10 %", "radius of the condyle: `femur.scale`", {"femur.scale": 0.9}
        ),
        Change("femoral size + 10 %", "the same", {"femur.scale": 1.1}),
        Change(
            "flexion angle + 5°",
            "`knee.flexion_offset`: markers, neutral pose",
            {},
            angle=math.radians(5.0),
        ),
        Change(
            "layer depth − 20 %",
            "of the 0.5 mm of osteoarthritis_as_printed.yaml",
            {"contact.layer_depth": 0.8 * layer},
            base="osteoarthritis_as_printed",
        ),
        Change(
            "layer depth + 20 %",
            "the same",
            {"contact.layer_depth": 1.2 * layer},
            base="osteoarthritis_as_printed",
        ),
    ]


def effect(change: Change, scene: Scene) -> Effect:
    """Effect of a change on a scene, with the measured knee, solved so finely that nothing but the input differs."""
    fine = {"fidelity.level": "dynamic", "fidelity.tolerance": 1e-9}

    def solved(values: dict[str, float], angle: float, load: float) -> Answer:
        model = load_model([change.base, CONFIG / "mri_knee.yaml", fine | values], compiled=True)
        return answer_of(model.run(scene.time, scene.angle + angle, load * scene.load))

    before, after = solved({}, 0.0, 1.0), solved(change.parameters, change.angle, change.load)
    depth, force = before.depth.max(), before.force.max()
    deeper, stronger = float(after.depth.max() - depth), float(after.force.max() - force)
    return Effect(
        change,
        scene.name,
        deeper,
        100.0 * deeper / depth,
        stronger,
        100.0 * stronger / force,
        apart(before, after),
    )


def measure(asked: Sequence[Scene], say: Callable[[str], None]) -> Study:
    """Measure all parts of the study; `say` prints the progress."""
    answers: dict[tuple[str, str], Answer] = {}
    rows, own = [], {}
    for geometry in geometries():
        for scene in asked:
            key = geometry.name, scene.name
            answers[key] = exact(geometry, scene)
            own[key] = apart(answers[key], exact(geometry, scene, COARSER))
            say(f"reference, {geometry.name}, {scene.name}: good to {own[key].depth:.0e} m")
        for level in LEVELS:
            for tolerance in TOLERANCES:
                rows += [
                    row(geometry, level, tolerance, scene, answers[geometry.name, scene.name])
                    for scene in asked
                ]
    left = [
        Left(geometry, scene, apart(answer, answers[MRI_KNEE, scene]), own[geometry, scene])
        for (geometry, scene), answer in answers.items()
    ]
    return Study(
        list(asked), rows, left, [effect(change, scene) for scene in asked for change in changes()]
    )


def row(geometry: Geometry, level: str, tolerance: float, scene: Scene, right: Answer) -> Row:
    """Errors and cost of a geometry at a level and tolerance on a scene."""
    fidelity = {"fidelity.level": level, "fidelity.tolerance": tolerance}
    model = load_model([*geometry.files, fidelity], compiled=True)
    seconds = []
    for _ in range(TURNS):
        begin = time.process_time()
        series = model.run(scene.time, scene.angle, scene.load)
        seconds.append(time.process_time() - begin)
    found, said = answer_of(series), series.status & Status.NOT_CONVERGED != 0
    wrong = ~said & (np.abs(found.depth - right.depth) > tolerance)
    return Row(
        geometry.name,
        level,
        tolerance,
        scene.name,
        apart(found, right),
        float(said.mean()),
        int(wrong.sum()),
        len(said),
        1e6 * min(seconds) / len(said),
    )


# The page.


def length(metres: float) -> str:
    """Format a length [m] as 19 nm; 0 where it is rounding."""
    if abs(metres) < 1e-15:
        return "0"
    units = ((1e-3, "mm"), (1e-6, "µm"), (1e-9, "nm"), (1e-12, "pm"))
    size, unit = next((each for each in units if abs(metres) >= 0.9995 * each[0]), units[-1])
    return f"{two_digits(metres / size)} {unit}"


def differences(found: Apart) -> str:
    """Format differences of depth, force and contact point."""
    force = "0" if abs(found.force) < 1e-6 else f"{two_digits(found.force)} N"
    return f"{length(found.depth)}, {force}, {length(found.x)}"


def two_digits(value: float) -> str:
    """Format two digits, without a power of ten where numbers are small enough."""
    rounded = float(f"{value:.2g}")
    return f"{rounded:.0f}" if abs(rounded) >= 10.0 else f"{rounded:.2g}"


def signed(value: float, unit: str) -> str:
    """Format a value with its sign and two digits."""
    return f"{'+' if value >= 0.0 else '−'}{two_digits(abs(value))} {unit}"


def with_block(page: str, block: str) -> str:
    """Replace the measured part of a page.

    Raises:
        ValueError: the page has no such part.
    """
    before, begin, rest = page.partition(BEGIN)
    _, end, after = rest.partition(END)
    if not (begin and end):
        raise ValueError(f"the page lacks the lines {BEGIN} and {END}")
    return f"{before}{BEGIN}\n\n{block.strip()}\n\n{END}{after}"


def block(study: Study, picture: str, measured_on: str) -> str:
    """Text of the measured part: picture, tables and scenes."""
    wrong, ticks = sum(row.wrong for row in study.rows), sum(row.ticks for row in study.rows)
    own = length(max(each.own.depth for each in study.left))
    names = [scene.name for scene in study.scenes]
    levels = []
    for (geometry, level, tolerance), rows in groupby(study.rows, key=lambda row: row[:3]):
        flagged = [
            (row, f", {100.0 * row.flagged:.2g} % flagged" if row.flagged else "") for row in rows
        ]
        cells = [
            f"{differences(row.error)}, {two_digits(row.microseconds)} µs{said}"
            for row, said in flagged
        ]
        levels.append([geometry, level, f"{tolerance:.0e}".replace("e-0", "e-"), *cells])
    by_geometry = groupby(study.left, key=lambda each: each.geometry)
    simpler = [
        [name, *(differences(each.error) for each in group)]
        for name, group in by_geometry
        if name != MRI_KNEE
    ]
    inputs = [
        [
            each.change.name,
            each.change.why,
            f"{signed(1e6 * each.depth, 'µm')} ({each.depth_percent:+.0f} %)",
            f"{signed(each.force, 'N')} ({each.force_percent:+.0f} %)",
            length(each.worst.x),
        ]
        for each in study.effects
        if each.scene == names[0]
    ]
    parts = [
        f"Made by `python -m studies.choosing` on {measured_on}.",
        f"![Error of depth, force and contact point over the cost of a tick, beside geometry and inputs]({picture})",
        "## Level and tolerance",
        "Against the same geometry solved exactly by other code (SciPy's DOP853, event by event). Every cell: the "
        "largest error of depth, of contact force and of the contact point's x on the plateau at any tick; processor "
        f"time per tick, compiled, the least of {TURNS} runs; behind that the ticks that say `NOT_CONVERGED`, if any "
        f"do. {wrong} of all {ticks} ticks say that they are within the tolerance and are not.",
        table(("geometry", "level", "tolerance [m]", *names), levels),
        "## Geometry",
        f"Each solved exactly, against the {MRI_KNEE}: what a simpler surface leaves out, whatever the level. Largest "
        "differences of depth, force and contact point at any tick. The exact solutions are good to "
        f"{own} (the largest difference from a second solution with 100 times the tolerance).",
        table(("geometry", *names), simpler),
        "## Inputs",
        "On the recorded gait with the MRI knee, one input changed at a time: change of the largest depth and force, "
        "and the largest move of the contact point at any tick.",
        table(("input", "", "peak depth", "peak force", "contact point"), inputs),
        "## Scenes",
        "All with the constants of [healthy.yaml](../../config/healthy.yaml) (Kelvin-Voigt, 9.3 kg); defined in "
        "[scenes.py](../../studies/choosing/scenes.py).",
        table(("scene", ""), [(scene.name, scene.about) for scene in study.scenes]),
    ]
    return "\n\n".join(parts)


def write_csv(study: Study, path: Path) -> None:
    """Write all numbers behind the page to a CSV file."""
    rows: list[Sequence[Any]] = [
        (
            "level",
            row.geometry,
            row.level,
            row.tolerance,
            row.scene,
            *row.error,
            row.flagged,
            row.wrong,
            row.ticks,
            row.microseconds,
        )
        for row in study.rows
    ]
    for left in study.left:
        rows += [
            (what, left.geometry, "", "", left.scene, *found)
            for what, found in (("geometry", left.error), ("reference", left.own))
        ]
    rows += [
        (f"input: {each.change.name}", MRI_KNEE, "", "", each.scene, *each.worst)
        for each in study.effects
    ]
    with path.open("w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(
            (
                "what",
                "geometry",
                "level",
                "tolerance_m",
                "scene",
                "depth_m",
                "force_n",
                "contact_x_m",
                "flagged",
                "ok_and_wrong",
                "ticks",
                "microseconds_per_tick",
            )
        )
        writer.writerows(
            [f"{value:.6g}" if isinstance(value, float) else value for value in row]
            for row in rows
        )


# The picture: error over cost, a column per scene and a row per output, beside what geometry and inputs leave open.

COLOURS = {"quasi_static": "#D55E00", "dynamic": "#0072B2"}
"""Colours of the levels: Okabe and Ito's, which colour-blind readers tell apart"""
MARKERS = {CIRCLE: "o", MRI_FEMUR: "s", MRI_KNEE: "^"}
LINES = {CIRCLE: ("#009E73", (0, (4, 4))), MRI_FEMUR: ("#CC79A7", (4, (4, 4)))}
"""Lines of simpler geometries: where two are the same, the dashes of one lie in the gaps of the other"""
OUTPUTS = (
    ("error of the depth [m]", (1e-11, 1e-1)),
    ("error of the force [N]", (1e-5, 1e5)),
    ("error of the contact\npoint on the plateau [m]", (1e-12, 1e-1)),
)
"""Outputs with the range of their axis; smaller values are drawn at the lower end"""
BAND_SHARE = 0.1
"""Least part of the largest effect of an input that counts for the band of the inputs"""


def draw(study: Study, path: Path) -> None:
    """Write the picture."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(11.0, 9.6), layout="constrained")
    FigureCanvasAgg(figure)
    axes: Any = figure.subplots(
        len(OUTPUTS), len(study.scenes), sharex=True, sharey="row", squeeze=False
    )
    for output, (label, ends) in enumerate(OUTPUTS):
        axes[output, 0].set_ylabel(label, fontsize=11)
        for axis, scene in zip(axes[output], study.scenes, strict=True):
            panel(axis, study, scene.name, output, ends)
    for axis, scene in zip(axes[0], study.scenes, strict=True):
        axis.set_title(scene.name, fontsize=11, fontweight="bold")
    for axis in axes[-1]:
        axis.set_xlabel("time per tick [µs]")
    known = {
        label: handle
        for handle, label in zip(*axes[0, 0].get_legend_handles_labels(), strict=True)
    }
    figure.legend(
        known.values(),
        known.keys(),
        loc="outside lower center",
        ncols=3,
        frameon=False,
        fontsize=10,
    )
    figure.savefig(path, dpi=150)


def panel(axis: Any, study: Study, scene: str, output: int, ends: tuple[float, float]) -> None:
    """Draw a line per geometry and level through its tolerances; the default one has a larger marker."""
    low, high = band([each for each in study.effects if each.scene == scene], output)
    axis.axhspan(
        low, high, color="#CFCFCF", zorder=0, linewidth=0, label="what uncertain inputs do"
    )
    for left in study.left:
        if left.scene == scene and left.geometry in LINES:
            colour, style = LINES[left.geometry]
            label = f"what the {left.geometry} leaves out"
            axis.axhline(
                left.error[output],
                color=colour,
                linewidth=2.0,
                linestyle=style,
                zorder=2,
                label=label,
            )
    chosen = (row for row in study.rows if row.scene == scene)
    for (geometry, level), group in groupby(chosen, key=lambda row: row[:2]):
        rows = list(group)
        errors = [min(max(row.error[output], ends[0]), ends[1]) for row in rows]
        sizes = [58 if row.tolerance == DEFAULT_TOLERANCE else 20 for row in rows]
        costs = [row.microseconds for row in rows]
        axis.plot(costs, errors, color=COLOURS[level], linewidth=1.0, alpha=0.7, zorder=3)
        axis.scatter(
            costs,
            errors,
            s=sizes,
            color=COLOURS[level],
            marker=MARKERS[geometry],
            zorder=4,
            clip_on=False,
            linewidths=0.5,
            edgecolors="white",
            label=f"{geometry}, {level}",
        )
    axis.set(xscale="log", yscale="log", ylim=ends)
    axis.grid(visible=True, which="major", color="0.9", linewidth=0.8)
    axis.set_axisbelow(True)


def band(effects: Sequence[Effect], output: int) -> tuple[float, float]:
    """Least and largest effect on an output of the inputs that matter for it."""
    sizes = [each.worst[output] for each in effects]
    return min(size for size in sizes if size >= BAND_SHARE * max(sizes)), max(sizes)


FILE = click.Path(path_type=Path, dir_okay=False)


@click.command()
@click.option("--page", type=FILE, default="docs/studies/choosing.md", show_default=True)
@click.option("--data", type=FILE, default="docs/studies/choosing.csv", show_default=True)
@click.option(
    "--picture", type=FILE, default="docs/images/choosing_fidelity.png", show_default=True
)
def main(page: Path, data: Path, picture: Path) -> None:
    """Measure what level, tolerance and geometry cost and leave out, beside what the inputs leave open."""
    text, measured_on = page.read_text(encoding="utf-8"), machine("numba")
    with_block(text, "")  # before an hour of work
    study = measure(scenes(), lambda done: click.echo(done, err=True))
    write_csv(study, data)
    draw(study, picture)
    seen = os.path.relpath(picture.resolve(), page.resolve().parent)
    page.write_text(with_block(text, block(study, seen, measured_on)), encoding="utf-8")


if __name__ == "__main__":
    main()
