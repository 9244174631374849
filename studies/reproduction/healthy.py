"""Loads, Table 1 and the healthy knee: peaks, depths, local radius and contact points."""

from __future__ import annotations

import math
from itertools import product

import numpy as np

from benchmarks.gait import BODY_WEIGHT
from knee_contact_ros.lab.report.figures import COMPUTED, PublishedRange
from knee_contact_ros.model.laws import hertz_stiffness, relative_radius
from studies.reproduction.scenes import (
    ARTHRITIC,
    CURVED_TIBIAE,
    CYCLE,
    HEALTHY,
    MECHANISMS,
    MM,
    MRI,
    N_MM,
    PERCENT,
    SPHERE_AND_CURVE,
    Moment,
    Table,
    at,
    body_weights,
    compare,
    gait,
    load_peaks,
    model,
    parameters,
    peak,
    phases,
    run,
    second_stance,
    static_depth,
    static_force,
    thousands,
    unprinted,
    within,
)

PAPER_PEAKS = (1.81, 2.19)
"""Load peaks of the paper [BW]"""
SUBJECT_WEIGHT = 72.6 * 9.80665
"""Weight [N] of the scaled model, whose gait it is"""


def loads() -> list[list[str]]:
    """Rows on the load peaks of the right leg."""
    rows = [
        compare(
            f"{name} load peak, second stance", paper, load_peak(time), "BW", 3, _why(time, bounds)
        )
        for name, paper, time, bounds in zip(
            ("first", "second"), PAPER_PEAKS, second_stance(), COMPUTED, strict=True
        )
    ]
    return rows + [
        unprinted(
            f"{name} load peak, first stance",
            f"{load_peak(time):.3f} BW",
            f"{_newton(time)}; another step of the same walk",
        )
        for name, time in zip(("first", "second"), load_peaks("right")[:2], strict=True)
    ]


def both_legs() -> Table:
    """Peaks of load, force and depth of all stances, healthy and arthritic."""
    header = (
        "leg",
        "time [s]",
        "load [BW]",
        "force, sphere [BW]",
        "force, curve [BW]",
        "depth, sphere [mm]",
        "depth, curve [mm]",
        "osteoarthritis: force, curve [BW]",
        "osteoarthritis: depth, curve [mm]",
    )
    return header, [
        _loads_line(side, time) for side in ("right", "left") for time in load_peaks(side)
    ]


def load_peak(time: float, side: str = "right") -> float:
    """Load [BW] at a time [s]."""
    return body_weights(at(time, gait(side)[2], side))


def _loads_line(side: str, time: float) -> list[str]:
    runs = [run(*files, side=side) for files in ((HEALTHY,), (HEALTHY, MRI), (ARTHRITIC, MRI))]
    force = [f"{body_weights(peak(time, series.contact_force, side)):.3f}" for series in runs]
    depth = [f"{MM * peak(time, series.penetration_depth, side):.4f}" for series in runs]
    return [
        side,
        f"{time:.3f}",
        f"{load_peak(time, side):.3f}",
        *force[:2],
        *depth[:2],
        force[2],
        depth[2],
    ]


def _newton(time: float) -> str:
    return f"{at(time, gait('right')[2]):.1f} N at {time:.3f} s"


def _why(time: float, bounds: PublishedRange) -> str:
    inside = "inside" if bounds.lowest <= load_peak(time) <= bounds.highest else "outside"
    return (
        f"{_newton(time)}: equal to the digits printed; {inside} the range of {bounds.lowest:g} to "
        f"{bounds.highest:g} BW computed for healthy people, which the paper cites"
    )


MATERIAL = (("contact.stiffness_from", "material"),)


def properties() -> Table:
    """Every property of Table 1, and those that it lacks."""
    contact = parameters(ARTHRITIC).contact
    femur = parameters(HEALTHY).femur
    rows = [
        _row(
            "K, cartilage",
            "2500 N/mm^1.5",
            "stiffness",
            f"{contact.stiffness:.6e} N/m^1.5",
            "calibrated",
        ),
        _row("C", "5 N s/mm", "damping", f"{contact.damping:g} N s/m", ""),
        _row("n", "1.5", "exponent", f"{contact.exponent:g}", ""),
        _row(
            "ν, cartilage",
            "0.38",
            "poissons_ratio",
            f"{contact.poissons_ratio:g}",
            "unused unless asked for",
        ),
        _row(
            "E, cartilage",
            "24 MPa",
            "youngs_modulus",
            f"{contact.youngs_modulus:.3g} Pa",
            "the same",
        ),
        _row(
            "ν, bone",
            "0.39",
            "poissons_ratio_2",
            f"{contact.poissons_ratio_2:g}",
            "the same; gives K₂",
        ),
        _row(
            "E, bone",
            "17 200 MPa",
            "youngs_modulus_2",
            f"{contact.youngs_modulus_2:.3g} Pa",
            "the same; gives K₂",
        ),
        _row(
            "K₂, bone",
            "not printed",
            "stiffness_2",
            f"{contact.stiffness_2:.4g} N/m^1.5",
            f"Hertz with bone's E, ν and the two radii: {thousands(bone_stiffness() * N_MM)} N/mm^1.5",
        ),
        _row(
            "h_s1",
            "0.5 mm (abstract)",
            "layer_depth",
            f"{contact.layer_depth:g} m",
            "not in the table",
        ),
        _row(
            "radii",
            "34 mm, 95 mm (text)",
            "femoral_radius, contact.tibial_radius",
            f"{contact.femoral_radius:g} m, {contact.tibial_radius:g} m",
            "for the stiffness; not in the table",
        ),
        [
            "femur's mass M",
            "not printed",
            "femur.mass",
            f"{femur.mass:g} kg",
            "femur of the 75.16 kg gait2354",
        ],
    ]
    return ("property", "paper", "our parameter", "default", "note"), rows


def bone_stiffness() -> float:
    """Stiffness of bone, K₂ [N/m^1.5]."""
    contact = parameters(ARTHRITIC).contact
    radius = relative_radius(contact.femoral_radius, contact.tibial_radius)
    return hertz_stiffness(contact.youngs_modulus_2, contact.poissons_ratio_2, radius)


def cartilage_stiffness() -> float:
    """K [N/m^1.5] that Table 1's cartilage would have as a half-space."""
    contact = parameters(ARTHRITIC).contact
    radius = relative_radius(contact.femoral_radius, contact.tibial_radius)
    return hertz_stiffness(contact.youngs_modulus, contact.poissons_ratio, radius)


def material_depth() -> float:
    """Static depth [m] at 2.19 BW with the stiffness of Table 1's cartilage."""
    return static_depth(2.19 * BODY_WEIGHT, HEALTHY, changes=MATERIAL)


def _row(what: str, paper: str, name: str, default: str, note: str) -> list[str]:
    return [what, paper, f"contact.{name}", default, note]


ABSTRACT_DEPTH, TEXT_DEPTH, REDUCTION = 0.795, 0.705, -0.6
"""Depths [mm] of abstract and text, and the reduction [%], in the paper"""
OFFSET = 0.997
"""Offset [mm] of Fig. 7"""


def forces() -> list[list[str]]:
    """Rows on the peaks of the contact force."""
    why = "the load's peak and the femur's inertia"
    rows = [
        compare(
            f"{name} peak, {femur}",
            paper,
            body_weights(peak(time, run(*files).contact_force)),
            "BW",
            3,
            why,
        )
        for name, paper, time in zip(
            ("first", "second"), PAPER_PEAKS, second_stance(), strict=True
        )
        for femur, files in SPHERE_AND_CURVE.items()
    ]
    stance = within(CYCLE[1], gait("right")[0][-1])
    difference = np.abs(run(HEALTHY, MRI).contact_force - run(HEALTHY).contact_force)
    rows.append(
        unprinted(
            "largest difference curve to sphere",
            f"{difference[stance].max():.1f} N in the second stance, {difference[1:].max():.1f} N over the bag",
            "the paper calls them similar; the load prescribes the force but for M ÿ",
        )
    )
    return rows


def depths() -> list[list[str]]:
    """Rows on the depth at the second peak, and on the femoral height."""
    sphere, curve = second_peak_depths()
    law = "Eq. 10 with Table 1 at this load allows no other value"
    stiffness = "{:.0f} N/mm^1.5 or a load of {:.2f} BW would be needed"
    return [
        compare(
            "depth, fitted curve (text)",
            TEXT_DEPTH,
            curve,
            "mm",
            4,
            f"{law}; {stiffness.format(*needed(TEXT_DEPTH))}",
        ),
        compare(
            "maximum depth (abstract)",
            ABSTRACT_DEPTH,
            curve,
            "mm",
            4,
            f"the same; {stiffness.format(*needed(ABSTRACT_DEPTH))}",
        ),
        compare("depth, sphere (text: 0.705 / 0.994)", 0.709, sphere, "mm", 4, law),
        compare(
            "curve against sphere",
            REDUCTION,
            PERCENT * (curve / sphere - 1.0),
            "%",
            3,
            "force-driven: the profile enters by inertia only",
        ),
        unprinted(
            "static depth at 1.81 and 2.19 BW",
            " and ".join(f"{MM * depth:.6f} mm" for depth in static_depths()),
            "F = K δ^1.5, no dynamics",
        ),
        *(
            unprinted(
                f"range of femoral height over a cycle, {femur} (Fig. 9b)",
                f"{MM * height_range(*files):.2f} mm",
                why,
            )
            for (femur, files), why in zip(
                SPHERE_AND_CURVE.items(),
                (
                    "the depth's range: the sphere's centre stays a radius above its lowest point",
                    "depth and support function h(θ): here the profile shows",
                ),
                strict=True,
            )
        ),
        unprinted(
            "largest difference curve to sphere over a cycle: height, and depth",
            "{:.2f} mm, and {:.4f} mm".format(*largest_differences()),
            "heights counted from heel strike; as the paper says, the height's is much the larger one",
        ),
        [
            "initial offset (Fig. 7)",
            f"{OFFSET:g} mm",
            f"static depth at the start: {start_depth():.3f} mm",
            "-",
            "not comparable: the paper does not say what it is measured from",
        ],
    ]


def second_peak_depths() -> tuple[float, float]:
    """Largest depth [mm] at the second peak, sphere and fitted curve."""
    time = second_stance()[1]
    return MM * peak(time, run(HEALTHY).penetration_depth), MM * peak(
        time, run(HEALTHY, MRI).penetration_depth
    )


def static_depths() -> tuple[float, float]:
    """Static depths [m] at the paper's two peaks."""
    first, second = (static_depth(load * BODY_WEIGHT, HEALTHY) for load in PAPER_PEAKS)
    return first, second


def needed(depth: float) -> tuple[float, float]:
    """Stiffness [N/mm^1.5] at 2.19 BW, or load [BW] with 2500, for a static depth [mm]."""
    force = static_force(depth / MM, HEALTHY)
    return 2500.0 * PAPER_PEAKS[1] / body_weights(force), body_weights(force)


def height_range(*files: str) -> float:
    """PublishedRange of the femoral height [m] over the complete cycle."""
    return float(np.ptp(run(*files).femoral_height[within(*CYCLE)]))


def largest_differences() -> tuple[float, float]:
    """Of femoral height (counted from heel strike) and depth [mm] between curve and sphere over the complete cycle."""
    sphere, curve = run(HEALTHY), run(HEALTHY, MRI)
    height = curve.femoral_height - sphere.femoral_height
    cycle = within(*CYCLE)
    return (
        MM * float(np.abs(height - at(CYCLE[1], height))[cycle].max()),
        MM * float(np.abs(curve.penetration_depth - sphere.penetration_depth)[cycle].max()),
    )


def start_depth() -> float:
    """Depth of the static start [mm]."""
    return MM * float(run(HEALTHY).penetration_depth[0])


WINDOWS = ((-15.0, 25.0), (20.0, 70.0), (60.0, 110.0))
"""Flexion angles [deg] at which the fitted part of the profile touches."""
AROUND = 10.0
"""Flexion [deg] on both sides of a load peak's angle at which the fitted part touches"""
NOMINAL, TIBIA, PLANE = 0.034, 0.095, math.inf
"""Radii [m] to which the 2500 N/mm^1.5 are taken to belong."""
REDUCED = 0.994
"""Ratio of the depths of curve and sphere in the paper"""


def local_radius() -> Table:
    """Static depths at 2.19 BW over the radius."""
    reference = static_depth(PAPER_PEAKS[1] * BODY_WEIGHT, HEALTHY)
    rows = [["sphere", f"{MM * NOMINAL:.1f} mm", *2 * (f"{MM * reference:.4f} mm (reference)",)]]
    for low, high, name in windows():
        radius = fitted_radius(low, high)
        depths = [depth_with(radius, tibia) for tibia in (PLANE, TIBIA)]
        part = f"fitted curve, touching at {low:.0f}° to {high:.0f}°{name}"
        compared = (
            f"{MM * depth:.4f} mm ({100 * (depth / reference - 1):+.1f} %)" for depth in depths
        )
        rows.append([part, f"{MM * radius:.1f} mm", *compared])
    return ("femur", "radius", "depth, plane", "depth, concave tibia"), rows


def windows() -> list[tuple[float, float, str]]:
    """Ranges of flexion [deg] with their names."""
    angle = gait("right")[1]
    peaks = [np.degrees(at(time, angle)) for time in second_stance()]
    around = [
        (round(peak - AROUND), round(peak + AROUND), f" ({name} peak)")
        for name, peak in zip(("first", "second"), peaks, strict=True)
    ]
    return [*((low, high, "") for low, high in WINDOWS), *around]


def fitted_radius(low: float, high: float) -> float:
    """Radius [m] of the circle through the part of the MRI profile that touches in a range of flexion [deg]."""
    points = model(HEALTHY, MRI).pair.femur.outline()
    tangent = np.gradient(points, axis=0)
    touches = np.degrees(np.arctan2(-tangent[:, 1], tangent[:, 0]))
    part = points[(touches >= low) & (touches <= high)]
    columns = np.column_stack([2.0 * part, np.ones(len(part))])
    x, y, rest = np.linalg.lstsq(columns, (part * part).sum(axis=1), rcond=None)[0]
    return float(np.sqrt(rest + x * x + y * y))


def depth_with(radius: float, tibia: float) -> float:
    """Static depth [m] at 2.19 BW with the stiffness of a femoral radius [m]."""
    ratio = math.sqrt(relative_radius(radius, tibia) / relative_radius(NOMINAL, tibia))
    stiffness = ratio * parameters(HEALTHY).contact.stiffness
    return static_depth(
        PAPER_PEAKS[1] * BODY_WEIGHT, HEALTHY, changes=(("contact.stiffness", stiffness),)
    )


def radius_needed() -> tuple[float, float]:
    """Femoral radius [m] that reduces the depth as the paper says, on the plane and in the concave tibia."""
    plane = NOMINAL / REDUCED**3
    relative = relative_radius(NOMINAL, TIBIA) / REDUCED**3
    return plane, 1.0 / (1.0 / relative + 1.0 / TIBIA)


def contact_points() -> Table:
    """Contact points: phases by geometry, over the mechanisms."""
    header = (
        "phase",
        "time [s]",
        "flexion [°]",
        "load [BW]",
        "femur",
        "depth [mm]",
        *(f"x, {name} [mm]" for name in MECHANISMS),
    )
    return header, [
        _contact_points_line(moment, femur, files)
        for femur, files in SPHERE_AND_CURVE.items()
        for moment in phases()
    ]


def curved_tibia() -> Table:
    """The general two-body case: a tibia that is curved."""
    header = (
        "phase",
        "tibia",
        "femur",
        "x [mm]",
        "y [mm]",
        "depth [mm]",
        "depth against the plane [%]",
    )
    return header, [
        _curved_line(moment, tibia, femur)
        for tibia, femur in product(CURVED_TIBIAE, SPHERE_AND_CURVE)
        for moment in phases()
    ]


def _contact_points_line(moment: Moment, femur: str, files: tuple[str, ...]) -> list[str]:
    _, angle, load = gait("right")
    runs = [run(*files, changes=changes) for changes in MECHANISMS.values()]
    return [
        moment.name,
        f"{moment.time:.3f}",
        f"{np.degrees(at(moment.time, angle)):.1f}",
        f"{body_weights(at(moment.time, load)):.3f}",
        femur,
        f"{MM * at(moment.time, runs[0].penetration_depth):.4f}",
        *(_signed(MM * at(moment.time, series.contact_point.x)) for series in runs),
    ]


def _curved_line(moment: Moment, tibia: str, femur: str) -> list[str]:
    files = SPHERE_AND_CURVE[femur]
    plane, curved = run(*files), run(*files, changes=CURVED_TIBIAE[tibia])
    depth, flat = (at(moment.time, series.penetration_depth) for series in (curved, plane))
    x, y = (MM * at(moment.time, curved.contact_point[axis]) for axis in "xy")
    change = _signed(100.0 * (depth / flat - 1.0))
    return [moment.name, tibia, femur, _signed(x), _signed(y), f"{MM * depth:.4f}", change]


def _signed(value: float) -> str:
    """Format a number with two decimals, without a negative zero."""
    return f"{round(value, 2) + 0.0:.2f}"
