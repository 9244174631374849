"""The loads (Fig. 6c), and the peaks of both legs."""

from __future__ import annotations

from benchmarks.report import Section
from knee_contact_ros.lab.report.figures import COMPUTED, Range
from studies.gait import BODY_WEIGHT
from studies.reproduction.page import COMPARISON, compare, unprinted
from studies.reproduction.phases import at, load_peaks, peak, second_stance
from studies.reproduction.scenes import ARTHRITIC, HEALTHY, MM, MRI, body_weights, gait, run

PAPER_PEAKS = (1.81, 2.19)
"""Load peaks of the paper [BW]"""
SUBJECT_WEIGHT = 72.6 * 9.80665
"""Weight [N] of the scaled model, whose gait it is"""


def section() -> Section:
    """Section on the load peaks of the right leg."""
    rows = [
        compare(f"{name} load peak, second stance", paper, load_peak(time), "BW", 3, _why(time, bounds))
        for name, paper, time, bounds in zip(("first", "second"), PAPER_PEAKS, second_stance(), COMPUTED, strict=True)
    ]
    rows += [
        unprinted(f"{name} load peak, first stance", f"{load_peak(time):.3f} BW",
                  f"{_newton(time)}; another step of the same walk")
        for name, time in zip(("first", "second"), load_peaks("right")[:2], strict=True)
    ]  # fmt: skip
    text = (
        "The load is half of the axial joint reaction of gait2354's right knee. Its peaks after the second heel "
        "strike (1.853 s) are the paper's to the two decimals printed, so the paper's \"medial\" force is a fixed "
        "share of one half and not a computed medial share (in vivo, 60 to 80 % are reported). The body weight of "
        f"{BODY_WEIGHT:.1f} N belongs to the unscaled model of 75.16 kg. The walk is that of the scaled model of "
        f"72.6 kg, and in its own body weight the two peaks are {_own(second_stance()[0])} and "
        f"{_own(second_stance()[1])} BW."
    )
    return Section("1. Loads (Fig. 6c)", text, COMPARISON, rows)


def both_legs() -> Section:
    """Section on the peaks of load, force and depth of all stances, healthy and arthritic."""
    header = (
        "leg", "time [s]", "load [BW]", "force, sphere [BW]", "force, curve [BW]", "depth, sphere [mm]",
        "depth, curve [mm]", "osteoarthritis: force, curve [BW]", "osteoarthritis: depth, curve [mm]",
    )  # fmt: skip
    left = load_peaks("left")
    rows = [_line(side, time) for side in ("right", "left") for time in load_peaks(side)]
    text = (
        "All load peaks of both bags; force and depth are the largest within 0.05 s of the load's. The paper treats "
        "one leg and does not say which; its two numbers fit the right one only. The left leg's second peaks of "
        f"{load_peak(left[0], 'left'):.2f} and {load_peak(left[2], 'left'):.2f} BW lie above the range that the "
        "paper cites (computed, of healthy people), in the same simulation of the same walk. The left bag begins "
        "within a stance, shortly before its first peak listed here."
    )
    return Section("8. Both legs", text, header, rows)


def load_peak(time: float, side: str = "right") -> float:
    """Load [BW] at a time [s]."""
    return body_weights(at(time, gait(side)[2], side))


def _line(side: str, time: float) -> list[str]:
    runs = [run(*files, side=side) for files in ((HEALTHY,), (HEALTHY, MRI), (ARTHRITIC, MRI))]
    force = [f"{body_weights(peak(time, series.contact_force, side)):.3f}" for series in runs]
    depth = [f"{MM * peak(time, series.penetration_depth, side):.4f}" for series in runs]
    return [side, f"{time:.3f}", f"{load_peak(time, side):.3f}", *force[:2], *depth[:2], force[2], depth[2]]


def _newton(time: float) -> str:
    return f"{at(time, gait('right')[2]):.1f} N at {time:.3f} s"


def _own(time: float) -> str:
    return f"{at(time, gait('right')[2]) / SUBJECT_WEIGHT:.2f}"


def _why(time: float, bounds: Range) -> str:
    inside = "inside" if bounds.lowest <= load_peak(time) <= bounds.highest else "outside"
    return (
        f"{_newton(time)}: equal to the digits printed; {inside} the range of {bounds.lowest:g} to "
        f"{bounds.highest:g} BW computed for healthy people, which the paper cites"
    )
