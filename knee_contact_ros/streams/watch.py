"""Watches a run for what no knee does: implausible inputs, depths, gaps, and an impossible split of a load.

Nothing is refused here: the user may model a rat. Each finding is one sentence, for log, summary and report.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from ..joint_reaction.compartments import STANDING_LOAD
from ..joint_reaction.estimator import body_weight_doubt
from ..model.inputs import AxisCheck, InputCheck
from ..model.knee import KneeModel
from ..model.types import (
    FLAT,
    MAX_CONTACT_X,
    MAX_FLEXION,
    MAX_SURFACE_GAP,
    MIN_FLEXION,
    MM,
    Floats,
    Rows,
    Status,
)
from ..parameters.doubts import beyond_words, parameter_doubts, typical_share
from ..parameters.schema import Parameters
from .conversion import written
from .topics import NANOSECONDS

if TYPE_CHECKING:
    from .pipeline import Pipeline

MAX_BEYOND_TABLE = 0.1
"""Largest fraction of samples under load that may lie beyond a table of shares without a warning"""
_IMPLAUSIBLE = int(Status.IMPLAUSIBLE)


def doubts_about(parameters: Parameters, model: KneeModel, is_lateral: bool = False) -> Doubts:
    """Make the doubts about parameters of a compartment, ready to watch a run of their model."""
    weight, share = parameters.body_weight, typical_share(parameters)
    inputs = InputCheck(
        None if body_weight_doubt(weight) else weight,
        not model.height_prescribed,
        1.0 - share if is_lateral else share,
        unit=unit_hint(parameters),
        compression=compression_words(parameters),
    )
    doubts = parameter_doubts(parameters, model)
    return Doubts(
        model.plausible_depth,
        beyond_words(model),
        doubts,
        inputs,
        AxisCheck(parameters.inputs()[1].topic, turned_by(parameters)),
    )


def unit_hint(parameters: Parameters) -> str:
    """Phrase that says how a source with fields takes degrees; empty if it has none."""
    source = parameters.angle_source
    return f" (write deg behind the field of {source})" if parameters.inputs()[0].fields else ""


def compression_words(parameters: Parameters) -> str:
    """Sign of a compression in the user's messages, and where it is."""
    topic, fields = parameters.inputs()[1].topic, parameters.inputs()[1].fields
    turned = turned_by(parameters)
    if turned or not fields:
        return f"force.y < 0 in {topic}{' after ' if turned else ''}{turned}"
    is_force = len(fields) > 2  # otherwise the first is the compression itself
    field = fields[int(is_force)]
    return f"{written(field)} {'<' if (field.factor > 0.0) == is_force else '>'} 0 in {topic}"


def turned_by(parameters: Parameters) -> str:
    """Name and value of the parameter by which forces are turned; empty if they are not."""
    if parameters.load.rotation:
        return f"load.rotation {parameters.load.rotation!r}"
    return f"frame.tibia {parameters.frame.tibia!r}" if parameters.frame.tibia else ""


@dataclass
class Doubts:
    """Watches a run for implausible inputs and answers."""

    plausible_depth: float = float("nan")
    """Largest plausible depth [m]; NaN if unknown"""
    limit: str = ""
    """Phrase for that depth"""
    about_parameters: list[str] = field(default_factory=list)
    """Sentences about the parameters; see `parameter_doubts`"""
    inputs: InputCheck = field(default_factory=InputCheck)
    """Angles and loads of the run"""
    axes: AxisCheck = field(default_factory=AxisCheck, compare=False)
    """Forces of the run as they came, if known; a recording's answers do not contain them"""
    too_deep: int = 0
    """Number of answers that are too deep, by their status bit or, in older recordings, by the limit"""
    deepest: float = 0.0
    """Largest depth [m] among these"""
    flown: int = 0
    """Number of answers with a gap that no knee has, or shortly after one"""
    farthest: float = 0.0
    """Largest gap [m]"""
    off: int = 0
    """Number of answers with a contact that is on no plateau"""
    off_by: float = 0.0
    """Largest distance [m] of such a contact from the tibia's origin, along x"""
    about_import: Sequence[str] = ()
    """What an importer doubted of the bag, as sentences"""

    def continue_with(self, other: Doubts) -> None:
        """Continue with the limit and the sentences of other parameters."""
        self.plausible_depth, self.limit = other.plausible_depth, other.limit
        self.about_parameters = other.about_parameters
        self.axes.turned_by = other.axes.turned_by
        self.inputs.body_weight, self.inputs.load_driven = (
            other.inputs.body_weight,
            other.inputs.load_driven,
        )
        self.inputs.share = other.inputs.share

    def add_answers(self, answers: Mapping[str, NDArray[Any]] | Rows) -> None:
        """Add answers, at least one, by the names of their fields."""
        if isinstance(answers, np.ndarray):
            answers = answers.view(FLAT)
        depths, gaps = answers["penetration_depth"], answers["gap"]
        self.inputs.add_samples(answers["stamp"], answers["flexion_angle"], answers["load"])
        angles, places = answers["flexion_angle"], np.abs(answers["contact_point_x"])
        off = (depths > 0.0) & (places > MAX_CONTACT_X)
        if off.any():
            self.off += int(np.count_nonzero(off))
            self.off_by = max(self.off_by, float(places[off].max()))
        flagged = (
            ((answers["status"] & _IMPLAUSIBLE) != 0)
            & ~off
            & (angles >= MIN_FLEXION)
            & (angles <= MAX_FLEXION)
        )
        self.farthest = max(self.farthest, float(gaps.max()))
        # After a flight that no knee makes, the bit means the flight and not a depth.
        flown = (gaps > MAX_SURFACE_GAP) | (
            flagged & ((depths <= 0.0) | (self.farthest > MAX_SURFACE_GAP))
        )
        self.flown += int(np.count_nonzero(flown))
        absurd = (flagged & ~flown) | (depths > self.plausible_depth)
        if absurd.any():
            self.too_deep += int(np.count_nonzero(absurd))
            self.deepest = max(self.deepest, float(depths[absurd].max()))

    @property
    def ticks(self) -> int:
        """Number of answers."""
        return self.inputs.ticks

    @property
    def implausible(self) -> int:
        """Number of answers that were found to be implausible."""
        return self.off + self.too_deep + self.flown

    @property
    def about_answers(self) -> list[str]:
        """Sentences about contacts on no plateau, implausible depths and implausible gaps."""
        limit, of = f", {self.limit}" if self.limit else "", f"of {self.ticks} ticks"
        sentences = {
            f"the contact is up to {MM * self.off_by:.3g} mm ahead of the tibia's origin or behind it, outside any "
            f"plateau, in {self.off} {of} (IMPLAUSIBLE): is the femur's profile in the femur's axes, with the origin "
            "in the knee (fit-profile --origin)?": self.off,
            f"{self.too_deep} {of} are up to {MM * self.deepest:.3g} mm deep{limit} (IMPLAUSIBLE)": self.too_deep,
            f"the femur is up to {MM * self.farthest:.4g} mm above the tibia, beyond {MM * MAX_SURFACE_GAP:.3g} mm: "
            f"{self.flown} {of} belong to this flight or its landing (IMPLAUSIBLE); does the load pull, by its sign or "
            "by the share of the compartment?": self.flown,
        }
        return [sentence for sentence, number in sentences.items() if number]

    @property
    def about_inputs(self) -> list[str]:
        """Sentences about angle, load and time; if the load is along another axis, only that sentence."""
        load = self.axes.sentence or self.inputs.about_load
        return [
            sentence
            for sentence in (
                self.inputs.about_angle,
                load,
                self.inputs.about_time,
                self.inputs.about_pairing,
            )
            if sentence
        ]

    @property
    def sentences(self) -> list[str]:
        """All sentences: about the import, parameters, depths, gaps and inputs."""
        answers = self.about_answers
        if self.flown and self.inputs.load_pulls:  # what it says of the gap follows from the loads
            answers.pop()
        return [*self.about_import, *self.about_parameters, *answers, *self.about_inputs]


@dataclass
class Split:
    """Statistics of a compartment's share of the axial load while the leg stood, in a run of any length."""

    body_weight: float
    """Body weight [N]"""
    samples: int = 0
    """Number of samples while the leg stood"""
    above: int = 0
    """Number of samples with a share above 1: the other compartment would have to pull"""
    below: int = 0
    """Number of samples with a share below 0: this compartment would have to pull"""
    at_bound: int = 0
    """Number of samples with a share of 0 or 1"""
    beyond: int = 0
    """Number of samples whose load or flexion lies beyond the table of shares"""
    smallest: float = math.inf
    """Smallest share"""
    largest: float = -math.inf
    """Largest share"""

    def add_sample(self, axial: float, load: float, beyond: bool = False) -> None:
        """Add a sample: axial compression [N], the compartment's load [N], and whether it lies beyond the table."""
        if axial >= STANDING_LOAD * self.body_weight:
            share = load / axial
            self.samples += 1
            self.above += share > 1.0
            self.below += share < 0.0
            self.at_bound += load in (0.0, axial)
            self.beyond += beyond
            self.smallest, self.largest = min(self.smallest, share), max(self.largest, share)

    def add_samples(
        self, axial: Floats, loads: Floats, beyond: NDArray[np.bool_] | bool = False
    ) -> None:
        """Add many samples, given as arrays of one shape; see `add_sample`."""
        stands = axial >= STANDING_LOAD * self.body_weight
        shares = loads[stands] / axial[stands]
        if len(shares):
            self.samples += len(shares)
            self.above += int((shares > 1.0).sum())
            self.below += int((shares < 0.0).sum())
            self.at_bound += int(((loads == 0.0) | (loads == axial))[stands].sum())
            self.beyond += int(np.count_nonzero(beyond & stands))
            self.smallest = min(self.smallest, float(shares.min()))
            self.largest = max(self.largest, float(shares.max()))

    @property
    def text(self) -> str:
        """Range of the shares, and how often they were 0, 1 or beyond the table, as text."""
        if not self.samples:
            return "the leg never stood"
        counted = (("0 or 1", self.at_bound), ("beyond the table", self.beyond))
        parts = [
            f"{what} in {100.0 * number / self.samples:.1f} %"
            for what, number in counted
            if number
        ]
        return ", ".join([f"{self.smallest:.2f} to {self.largest:.2f}", *parts])

    @property
    def problem(self) -> str:
        """Reason why the split cannot be used; empty if it can."""
        if self.beyond > MAX_BEYOND_TABLE * self.samples:
            return (
                f"load or flexion lie beyond the table of shares in {100.0 * self.beyond / self.samples:.1f} % of the "
                "samples under load, where its edge is used: is load.share_file of another gait, or body_weight of "
                "another person?"
            )
        if not self.above and not self.below:
            return ""
        above, below = (100.0 * number / self.samples for number in (self.above, self.below))
        return (
            f"the compartment's share of the axial load is {self.text}, above 1 in {above:.1f} % and below 0 in "
            f"{below:.1f} % of the samples under load: the frontal moment cannot be split between two compartments so "
            "far apart (load.compartment_spacing); load.compartment fixed_share needs no moment"
        )


MAX_UNANSWERED = 0.05
"""Fraction of forces without an answer above which a run is incomplete"""
ADVICE = {
    "no_angle_before": "there are no angles at their times: are these in another bag, or by another clock?",
    "no_stamp": "the publisher has to set it",
    "frame_changed": "the publisher has to keep one frame_id; forces of several sensors are runs of their own",
    "frame_unknown": "give a static transform or load.rotation, or an empty frame.tibia if they are in the tibia frame",
    "joint_missing": "knee.joint_name has to be a joint of every sample",
    "too_large": "the topic has to carry joint states or forces only",
    "lengths_differ": "the publisher has to give a position for every name",
    "out_of_range": "if it is another unit, name it behind the field of the source, as in TOPIC TYPE position[0] deg",
    "not_finite": "the sensor gives no number",
}
"""Advice, by the most frequent reason of refusals"""


def held_sentence(pipeline: Pipeline[Any], held: int) -> str:
    """Sentence that most answers have an angle of another time, as `held` of them do, and what to do; else empty."""
    if 2 * held <= pipeline.ticks:
        return ""
    angles, forces = pipeline.sources.values()
    apart = (
        (pipeline.synchroniser.load_time.last or 0) - (pipeline.synchroniser.angle_time.last or 0)
    ) / NANOSECONDS
    why = (
        pipeline.last_refusal
        or f"their stamps lie {apart:.4g} s apart: does one of them count from boot?"
    )
    return f"{held} of {pipeline.ticks} answers to {forces} hold an old angle of {angles} (INPUT_HELD): {why}"


def unanswered_sentence(pipeline: Pipeline[Any], forces: int, has_angles: bool) -> str:
    """Sentence that many of a number of forces have no answer, with the reasons and what to do; else empty.

    `has_angles`: whether any angle came.
    """
    missing = forces - pipeline.ticks
    if missing <= max(MAX_UNANSWERED * forces, min(pipeline.ticks, 1)):
        return ""
    refused = pipeline.synchroniser.refused
    reasons = [f"{count} x {reason}" for reason, count in refused.most_common()]
    why = "; ".join(filter(None, (", ".join(reasons), pipeline.last_refusal)))
    most = next((reason for reason, _ in refused.most_common()), "")
    advice = ADVICE.get(most, "look at the stamps")
    if not has_angles:
        why, advice = "", f"is {next(iter(pipeline.sources.values()))} the topic of the angles?"
    return f"{missing} of {forces} forces have no answer ({why or 'no angle came'}): {advice}"
