"""Published ranges of forces and depths, which figures show behind the curves, with their sources.

Every number was read in the source named with it.
"""

from __future__ import annotations

from typing import NamedTuple

from knee_contact_ros.parameters.schema import Parameters, has_both

CARTILAGE_THICKNESS = 3.0
"""Thickness of resting cartilage [mm] that the range of depths assumes, as the model's paper does"""
FIRST_PEAK, SECOND_PEAK = (8.0, 24.0), (38.0, 54.0)
"""Percent of the gait cycle in which the peaks of stance are expected; the sources have no times"""


class Source(NamedTuple):
    """Publication from which a range comes."""

    short: str
    text: str
    identifier: str
    """DOI or another identifier; empty: none is known"""


class Range(NamedTuple):
    """Published range of the peak of a force or depth."""

    what: str
    """Text for a legend: what was measured or computed, and in whom"""
    lowest: float
    """Lower end [BW] for a force, [mm] for a depth; equal to `highest` where the source has a single number"""
    highest: float
    window: tuple[float, float]
    """Percent of the gait cycle between which the range is drawn"""
    sources: tuple[int, ...]
    """Indices in `SOURCES`"""

    @property
    def text(self) -> str:
        """Text for a legend of the report, with the numbers of the sources, counted from 1."""
        return f"{self.what} [{', '.join(str(number + 1) for number in self.sources)}]"


SOURCES = (
    Source(
        "Kutzner et al. 2010",
        "Kutzner I. et al. (2010): Loading of the knee joint during activities of daily living measured in vivo in "
        "five subjects. J Biomech 43:2164–2173. Total resultant force, level walking, instrumented knee implants: "
        "261 % of body weight, the mean of five subjects' peaks.",
        "doi:10.1016/j.jbiomech.2010.03.046",
    ),
    Source(
        "D'Lima et al. 2013",
        "D'Lima D. D., Fregly B. J., Colwell C. W. (2013): Implantable sensor technology: measuring bone and joint "
        "biomechanics of daily life in vivo. Arthritis Res Ther 15:203. Peak tibial force, walking on a laboratory "
        "floor, instrumented knee implants, of the five studies that its table 1 names: 2.5–2.8 body weights.",
        "doi:10.1186/ar4138",
    ),
    Source(
        "Erhart et al. 2010",
        "Erhart J. C. et al. (2010): Changes in in vivo knee loading with a variable-stiffness intervention shoe "
        "correlate with changes in the knee adduction moment. J Orthop Res 28. The medial compartment takes some "
        "60–80 % of the total, as its introduction says of the studies that it names; not its own measurement.",
        "PMC2965044",
    ),
    Source(
        "the model's paper, 2025",
        "“The prediction of knee contact forces with the novel two-dimensional dynamic model of human knee” (2025), "
        "the model's paper. Medial force of healthy people walking in the studies that it names: first peak 1.8–2, "
        "second peak 2–2.3 body weights. It does not say how they came about; in a knee without an implant that force "
        "cannot be measured, but only computed.",
        "",
    ),
    Source(
        "Liu et al. 2010",
        "Liu F. et al. (2010): In vivo tibiofemoral cartilage deformation during the stance phase of gait. J Biomech "
        "43:658–665, as quoted by the model's paper: peak deformations of 7–23 % of the resting thickness, in healthy "
        "people, by dual fluoroscopy and MRI.",
        "",
    ),
)

STANCE = (FIRST_PEAK[0], SECOND_PEAK[1])
MEAN_PEAK, PEAKS = 2.61, (2.5, 2.8)
"""Peak of the total force [BW]: the mean of five people, and the range of five studies"""
MEDIAL_SHARES = (0.6, 0.8)
TOTAL = (
    Range("total, in vivo, knee implants: 2.5–2.8 BW", *PEAKS, STANCE, (1,)),
    Range("total, in vivo, knee implants: mean 2.61 BW", MEAN_PEAK, MEAN_PEAK, STANCE, (0,)),
)
MEDIAL = (
    Range(
        "60–80 % of the total in vivo (knee implants: 2.5–2.8 BW)",
        MEDIAL_SHARES[0] * PEAKS[0],
        MEDIAL_SHARES[1] * PEAKS[1],
        STANCE,
        (1, 2),
    ),
    Range("computed, healthy people: 1.8–2, 2–2.3 BW", 1.8, 2.0, FIRST_PEAK, (3,)),
    Range("computed, healthy people: 1.8–2, 2–2.3 BW", 2.0, 2.3, SECOND_PEAK, (3,)),
)
COMPUTED = MEDIAL[1:]
"""Computed ranges of the first and the second peak, with which the model's paper compares its own results"""
DEPTH = Range(
    f"in vivo, MRI and fluoroscopy: 7–23 % of {CARTILAGE_THICKNESS:g} mm", 0.07 * CARTILAGE_THICKNESS,
    0.23 * CARTILAGE_THICKNESS, (0.0, 100.0), (4,),
)  # fmt: skip


def is_total(parameters: Parameters) -> bool:
    """Whether the load is that of the whole joint, and not of a single compartment."""
    whole = parameters.load.rule == "fixed_share" and parameters.load.share == 1.0
    return whole or parameters.load.compartment == "total"


def which_load(parameters: Parameters) -> str:
    """Describe the load of a run by its parameters, for the page and its tables."""
    if is_total(parameters):
        return "total: the whole axial joint reaction"
    rest = "; lateral: the rest" if has_both(parameters) else ""
    if parameters.load.rule == "moment_balance":
        return f"medial compartment: what balances the frontal moment of the joint reaction{rest}"
    if parameters.load.rule == "measured_share":
        return f"medial compartment: the share of the axial joint reaction that {parameters.load.share_file} has{rest}"
    return f"medial compartment: {parameters.load.share:g} of the axial joint reaction{rest}"
