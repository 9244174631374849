"""When can the contact force drop in osteoarthritis? 10 000 knees, with the load or the femur's height prescribed.

python -m studies.osteoarthritis [--folder docs]
"""

from __future__ import annotations

import csv
import warnings
from pathlib import Path
from typing import Any, NamedTuple

import click
import numpy as np
from numpy.typing import NDArray

import knee_contact_ros
from benchmarks.gait import BODY_WEIGHT
from benchmarks.report import Section, machine, save
from knee_contact_ros.lab.study_file import Study, read_study
from knee_contact_ros.parameters.files import load_parameters

Floats = NDArray[np.float64]
MM, SAME = 1e3, 0.01
"""Factor from metres; part by which a peak force may differ from the healthy one and count as unchanged"""
ROOT = Path(__file__).parents[1]
STUDY = Path(__file__).with_suffix(".yaml")
BAG = ROOT / "bags" / "gait2354_right"
SHARE, LAYER, SECOND = "load.share", "contact.layer_depth", "contact.stiffness_2"
SHIPPED = load_parameters("osteoarthritis").contact
FIRST = SHIPPED.stiffness
"""K₁ [N/m^1.5], the healthy knee's stiffness too"""
TOLERANCE = {"fidelity.tolerance": 1e-9}
BANDS = (0.15, 0.25, 0.5, 0.75, 0.95, 1.05, 2.0, 5.0, 20.0, 130.0)
"""Bounds of the colours for ratios of forces; the middle band is drawn as no change"""
QUESTION = """
The paper that this package follows models an arthritic knee as 0.5 mm of cartilage on bone. It finds less
penetration than in a healthy knee, **and a lower contact force**. When can that be?

All knees walk the shipped gait of the right leg. They differ
in the first layer h (`contact.layer_depth`, {layers[0]:g} to {layers[1]:g} mm, 25 values), the second stiffness
K₂ (`contact.stiffness_2`, {seconds[0]:.2g} to {seconds[1]:.3g} K₁, 20 values), the share of the load (0.5 to 0.8, 10
values), and in what is prescribed: the load, or the femur's height in the healthy knee of the same share. The first
half is a study file: `knee-contact sweep studies/osteoarthritis.yaml --output oa`.
"""
ANSWER = """
In this model a lower contact force does not come from the arthritic knee. It comes from what is held fixed while the
cartilage changes.

**Load given**: the contact force balances the load, whatever the layers are made of: ∫ F dt = ∫ L dt + M Δẏ. Peaks are
{forced[0]:.3f} to {forced[1]:.3f} of the healthy one, with the dashpot in both layers. As printed, the first layer is
undamped, and the knee rings: peaks were then up to 1.05 of the healthy one. What changes
is depth, pressure and time on the second layer.

**Height given**: at rest the force drops if h < δ and K₂ / K₁ < (δ^1.5 - h^1.5) / (δ - h)^1.5, with δ the healthy
knee's largest depth, {depths[0]:.3f} mm at share 0.5 and {depths[1]:.3f} mm at 0.8. For h = 0.5 mm and share 0.5 the
limit is {limit:.1f} K₁, and bone is {bone:.1f} K₁. This rule is right for {right} of the {reached} knees that reach
their second layer. On the shipped bone the force is {shipped:.1f} times the healthy one. If wear also lowers the
surface by ℓ, the force drops once ℓ exceeds the difference of the two depths under the load:
{lost:.3f} mm for the shipped knee.

Every knee at shares 0.5 and 0.8 is in [osteoarthritis.csv](osteoarthritis.csv). One layer of one planar knee
without menisci, ligaments and friction: nothing here is a statement about patients.

![Peak contact force over the healthy knee's, for both drives and two shares](../images/osteoarthritis_force.png)
"""
CHOSEN = ((0.25, 39.4), (0.5, 39.4), (0.5, 2.68), (0.5, 0.848), (0.7, 39.4), (1.0, 39.4))
"""Layers [mm] and K₂ / K₁ in the table"""


class Knees(NamedTuple):
    """Outcomes: of the healthy knee for each share; of the others by share, layer and second stiffness."""

    axes: tuple[Floats, Floats, Floats]
    """Shares, layers [m] and second stiffnesses [N/m^1.5]"""
    healthy: Any
    forced: Any
    """With the load prescribed"""
    led: Any
    """With the healthy knee's height prescribed"""

    def ratio(self, of: Any) -> Floats:
        """Peak force over the healthy knee's of the same share."""
        return np.asarray(of.peak_force / self.healthy.peak_force[:, None, None])


def compute(axes: tuple[Floats, Floats, Floats]) -> Knees:
    """Compute every knee of a grid under both drives."""
    shape = tuple(map(len, axes))
    values = dict(
        zip(
            (SHARE, LAYER, SECOND),
            (one.ravel() for one in np.meshgrid(*axes, indexing="ij")),
            strict=True,
        )
    )
    with warnings.catch_warnings():
        warnings.simplefilter(
            "ignore", UserWarning
        )  # a second layer softer than cartilage is asked for
        healthy = knee_contact_ros.sweep(
            BAG, {SHARE: axes[0], **TOLERANCE}, "healthy", series=True
        )
        forced = knee_contact_ros.sweep(BAG, {**values, **TOLERANCE}, "osteoarthritis")
        led = [
            along(path, {name: values[name][values[SHARE] == share] for name in (LAYER, SECOND)})
            for path, share in zip(np.asarray(healthy.series), axes[0], strict=True)
        ]
    return Knees(
        axes,
        healthy.outcomes,
        forced.outcomes.reshape(shape),
        np.stack(led).reshape(shape).view(np.recarray),
    )


def along(path: Any, values: dict[str, Floats], raised: float = 0.0) -> Any:
    """Outcomes of arthritic knees whose height is that of a healthy run's answers, `raised` [m]."""
    gait = {
        "time": 1e-9 * path["stamp"],
        "flexion_angle": path["flexion_angle"],
        "femoral_height": path["femoral_height"] + raised,
    }
    return knee_contact_ros.sweep(
        gait, values, ["osteoarthritis", {"drive": "displacement", **TOLERANCE}]
    ).outcomes


def limit(layer: Floats | float, depth: float) -> Floats:
    """K₂ [N/m^1.5] with which a layer [m] gives at a depth [m] the healthy knee's force; infinite if not passed."""
    n = SHIPPED.exponent
    over = np.maximum(depth - np.asarray(layer), 0.0) ** n
    missing = FIRST * (depth**n - np.asarray(layer) ** n)
    return np.asarray(np.divide(missing, over, out=np.full_like(over, np.inf), where=over > 0.0))


def sections(knees: Knees) -> list[Section]:
    """The page: question, result and picture."""
    _, layers, seconds = knees.axes
    forced, led, depth = (
        knees.ratio(knees.forced),
        knees.ratio(knees.led),
        knees.healthy.peak_depth,
    )
    reached = np.broadcast_to(layers[None, :, None] < depth[:, None, None], led.shape)
    limits = np.stack([limit(layers, float(one)) for one in depth])
    right = reached & ((led > 1.0) == (seconds > limits[..., None]))
    cell = (
        0,
        int(np.argmin(np.abs(layers - SHIPPED.layer_depth))),
        int(np.argmin(np.abs(seconds - SHIPPED.stiffness_2))),
    )
    counts = [
        (
            name,
            *(
                str(int(one.sum()))
                for one in (ratio < 1.0 - SAME, abs(ratio - 1.0) <= SAME, ratio > 1.0 + SAME)
            ),
            f"{ratio.min():.3f} to {ratio.max():.3g}",
        )
        for name, ratio in (("load", forced), ("femur's height", led))
    ]
    answer = ANSWER.format(
        forced=(forced.min(), forced.max()),
        depths=MM * depth[[0, -1]],
        bone=SHIPPED.stiffness_2 / FIRST,
        limit=float(limit(SHIPPED.layer_depth, float(depth[0]))) / FIRST,
        right=int(right.sum()),
        reached=int(reached.sum()),
        shipped=led[cell],
        lost=MM * (depth[0] - knees.forced.peak_depth[cell]),
    )
    rows = []
    for layer, second in CHOSEN:
        at = (
            0,
            int(np.argmin(np.abs(MM * layers - layer))),
            int(np.argmin(np.abs(seconds / FIRST - second))),
        )
        numbers = (
            knees.forced.peak_force[at] / BODY_WEIGHT,
            MM * knees.forced.peak_depth[at],
            1e-6 * knees.forced.peak_pressure[at],
            knees.led.peak_force[at] / BODY_WEIGHT,
        )
        rows.append(
            (
                f"{MM * layers[at[1]]:g}",
                f"{seconds[at[2]] / FIRST:.3g}",
                *(f"{one:.3f}" for one in numbers),
            )
        )
    own = knees.healthy[0]
    force = f"{own.peak_force / BODY_WEIGHT:.3f}"
    rows.insert(
        0,
        (
            "healthy",
            "",
            force,
            f"{MM * own.peak_depth:.3f}",
            f"{1e-6 * own.peak_pressure:.3f}",
            force,
        ),
    )
    ends = {"layers": MM * layers[[0, -1]], "seconds": seconds[[0, -1]] / FIRST}
    return [
        Section(
            "",
            QUESTION.strip().format(**ends),
            ("given", "drops", "within 1 %", "rises", "of the healthy peak"),
            counts,
        ),
        Section("The answer", answer.strip(), (), ()),
        Section(
            "Some knees",
            "Share 0.5; BW is 737 N.",
            (
                "h [mm]",
                "K₂ / K₁",
                "load given: force [BW]",
                "depth [mm]",
                "pressure [MPa]",
                "height given: force [BW]",
            ),
            rows,
        ),
    ]


def draw(knees: Knees, path: Path) -> None:
    """Draw the peak force over the healthy one, under both drives at the ends of the shares."""
    from matplotlib.colors import BoundaryNorm
    from matplotlib.figure import Figure

    shares, layers, seconds = knees.axes
    figure = Figure(figsize=(8.0, 6.2), layout="constrained")
    axes = figure.subplots(2, 2, sharex=True, sharey=True)
    for row, place in zip(axes, (0, -1), strict=True):
        for axis, of, title in zip(
            row, (knees.forced, knees.led), ("load given", "height given"), strict=True
        ):
            image = axis.pcolormesh(
                MM * layers,
                seconds / FIRST,
                knees.ratio(of)[place].T,
                cmap="RdBu_r",
                norm=BoundaryNorm(BANDS, 256),
                shading="nearest",
                rasterized=True,
            )
            axis.axvline(
                MM * knees.healthy.peak_depth[place],
                color="black",
                linestyle="--",
                label="healthy depth",
            )
            axis.plot(
                MM * SHIPPED.layer_depth,
                SHIPPED.stiffness_2 / FIRST,
                "*",
                color="black",
                label="shipped knee",
            )
            axis.set(xscale="log", yscale="log", title=f"{title}, share {shares[place]:.1f}")
            axis.set_xticks([0.25, 0.5, 1.0, 2.0], ["0.25", "0.5", "1", "2"])
            axis.minorticks_off()
    fine = np.linspace(layers[0], knees.healthy.peak_depth[0], 200)[:-1]
    axes[0, 1].plot(
        MM * fine,
        limit(fine, float(knees.healthy.peak_depth[0])) / FIRST,
        "k",
        label="the limit at rest",
    )
    axes[0, 1].legend(fontsize=8, loc="upper right")
    figure.supxlabel("first layer h [mm]")
    figure.supylabel("second stiffness K₂ / K₁")
    figure.colorbar(
        image,
        ax=axes,
        ticks=BANDS,
        spacing="uniform",
        format="%g",
        label="peak force over the healthy knee's",
    )
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=130, metadata={"Software": None})


HEADER = (
    "share",
    "layer_mm",
    "stiffness_2",
    "force_drive_peak_n",
    "force_drive_over_healthy",
    "force_drive_depth_mm",
    "force_drive_second_layer_s",
    "force_drive_pressure_mpa",
    "displacement_peak_n",
    "displacement_over_healthy",
)


def write_csv(knees: Knees, path: Path) -> None:
    """Write the knees at the ends of the shares, with five digits."""
    forced, led, (shares, layers, seconds) = (
        knees.ratio(knees.forced),
        knees.ratio(knees.led),
        knees.axes,
    )
    path.parent.mkdir(parents=True, exist_ok=True)
    with path.open("w", encoding="utf-8", newline="") as file:
        rows = csv.writer(file, lineterminator="\n")
        rows.writerow(HEADER)
        for cell in np.ndindex(forced.shape):
            if cell[0] in {0, len(shares) - 1}:
                of = knees.forced[cell]
                numbers = (
                    shares[cell[0]],
                    MM * layers[cell[1]],
                    seconds[cell[2]],
                    of.peak_force,
                    forced[cell],
                    MM * of.peak_depth,
                    of.bone_time,
                    1e-6 * of.peak_pressure,
                    knees.led.peak_force[cell],
                    led[cell],
                )
                rows.writerow([f"{number:.5g}" for number in numbers])


@click.command()
@click.option(
    "--folder",
    type=click.Path(path_type=Path),
    default=Path("docs"),
    help="Gets studies/ and images/.",
)
def main(folder: Path) -> None:
    """Compute all knees, and write page, picture and table."""
    grid = read_study(STUDY, Study).grid
    knees = compute((np.array(grid[SHARE]), np.array(grid[LAYER]), np.array(grid[SECOND])))
    save(
        folder / "studies" / "osteoarthritis-study.md",
        "Can the contact force drop in osteoarthritis?",
        "python -m studies.osteoarthritis",
        sections(knees),
        machine(),
    )
    write_csv(knees, folder / "studies" / "osteoarthritis.csv")
    draw(knees, folder / "images" / "osteoarthritis_force.png")


if __name__ == "__main__":
    main()
