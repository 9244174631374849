"""Write docs/studies/reproduction.md, its tables and its figures."""

from __future__ import annotations

import csv
import math
from pathlib import Path

import click

from benchmarks.gait import BODY_WEIGHT
from benchmarks.report import machine, table
from studies.reproduction import healthy, osteoarthritis
from studies.reproduction.scenes import (
    ARTHRITIC,
    HEALTHY,
    MM,
    MRI,
    N_MM,
    PERCENT,
    Table,
    at,
    body_weights,
    gait,
    load_peaks,
    second_stance,
    static_force,
    thousands,
)


def tables() -> dict[str, Table]:
    """All tables by the names of their files."""
    comparison = healthy.loads() + healthy.forces() + healthy.depths() + osteoarthritis.arthritic()
    return {
        "comparison": (("quantity", "paper", "ours", "difference", "why"), comparison),
        "properties": healthy.properties(),
        "local_radius": healthy.local_radius(),
        "contact_points": healthy.contact_points(),
        "curved_tibia": healthy.curved_tibia(),
        "cartilage_lost": osteoarthritis.cartilage_lost(),
        "ringing": osteoarthritis.ringing(),
        "time_step": osteoarthritis.time_step(),
        "both_legs": healthy.both_legs(),
    }


def page(tables: dict[str, Table], measured_on: str) -> str:
    """The page, with its numbers filled in."""
    header, rows = tables["comparison"]
    left = load_peaks("left")
    sphere, curve = healthy.second_peak_depths()
    own = [at(time, gait("right")[2]) / healthy.SUBJECT_WEIGHT for time in second_stance()]
    needed = {
        "text": healthy.needed(healthy.TEXT_DEPTH),
        "abstract": healthy.needed(healthy.ABSTRACT_DEPTH),
    }
    plane, concave = healthy.radius_needed()
    soft = healthy.cartilage_stiffness() * N_MM
    stiffness, frequency, damping = osteoarthritis.linearised()
    loss, period = osteoarthritis.loss_for_paper(), math.tau / frequency
    arthritic_depth = MM * osteoarthritis.arthritic_depth()
    return (
        Path(__file__)
        .with_name("page.txt")
        .read_text(encoding="utf-8")
        .format(
            machine=measured_on,
            body_weight=BODY_WEIGHT,
            comparison=table(header[:4], [row[:4] for row in rows if row[3] != "-"]),
            healthy_depth=curve,
            arthritic_depth=arthritic_depth,
            bone_part=arthritic_depth - osteoarthritis.CARTILAGE,
            own_first=own[0],
            own_second=own[1],
            left_one=healthy.load_peak(left[0], "left"),
            left_other=healthy.load_peak(left[2], "left"),
            text_stiffness=needed["text"][0],
            text_load=needed["text"][1],
            abstract_stiffness=needed["abstract"][0],
            abstract_load=needed["abstract"][1],
            curve_height=MM * healthy.height_range(HEALTHY, MRI),
            sphere_height=MM * healthy.height_range(HEALTHY),
            offset_load=body_weights(static_force(healthy.OFFSET / MM, HEALTHY)),
            plane_radius=MM * plane,
            concave_radius=MM * concave,
            soft=soft,
            times_less=2500.0 / soft,
            material_depth=MM * healthy.material_depth(),
            tibia_change=max(abs(float(row[-1])) for row in tables["curved_tibia"][1]),
            curve_change=PERCENT * (curve / sphere - 1.0),
            carried=body_weights(static_force(osteoarthritis.CARTILAGE / MM, ARTHRITIC)),
            bone=thousands(healthy.bone_stiffness() * N_MM),
            bone_needed=thousands(round(osteoarthritis.bone_stiffness_needed(), -3)),
            load_needed=osteoarthritis.load_needed(),
            break_even=osteoarthritis.break_even(),
            loss=loss,
            loss_force=osteoarthritis.largest_force(loss),
            same_depth=float(tables["cartilage_lost"][1][0][-1]),
            jump=tables["ringing"][1][0][-1].removeprefix("up to "),
            stiffness=stiffness / 1e6,
            frequency=frequency,
            damping=damping,
            period=1e3 * period,
            orders=math.log10(period / osteoarthritis.PAPER_STEP),
            evaluations=osteoarthritis.evaluations(),
        )
    )


def write(folder: Path, measured_on: str) -> None:
    """Write reproduction.md and reproduction/*.csv into a folder."""
    made = tables()
    (folder / "reproduction").mkdir(parents=True, exist_ok=True)
    for name, (header, rows) in made.items():
        with (folder / "reproduction" / f"{name}.csv").open(
            "w", encoding="utf-8", newline=""
        ) as file:
            csv.writer(file, lineterminator="\n").writerows([header, *rows])
    (folder / "reproduction.md").write_text(page(made, measured_on), encoding="utf-8")


@click.command()
@click.option(
    "--folder",
    type=click.Path(path_type=Path),
    default=Path("docs"),
    help="gets studies/ and images/",
)
def main(folder: Path) -> None:
    """Compute all numbers, draw the figures and write the page."""
    from studies.reproduction.figures import draw

    write(folder / "studies", machine())
    draw(folder / "images")


if __name__ == "__main__":
    main()
