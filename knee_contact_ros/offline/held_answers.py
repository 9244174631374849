"""Compares computed answers with those that the bag holds, whose parameters another tool may have lost."""

import numpy as np

from ..bags.answers import answer_blocks, answer_topics
from ..bags.bag import Bag
from ..bags.names import NAMESPACE, Names, absolute
from ..model.knee import KneeModel
from ..model.types import MM, UNUSABLE, Rows, Status
from ..streams.topics import KNEE_CONTACT
from ..system.errors import UsageError
from .solve_blocks import AnswerBlock

MOST_COMPARED = 200_000
"""Largest number of answers that are compared; it bounds the memory"""
LARGEST_DIFFERENCE, LEAST_DIFFERENCE = 0.01, 2e-6
"""Largest difference of two depths that count as equal, as a part of the largest depth; and in [m]"""
FEW = 0.01
"""Fraction of answers that may differ: a run may begin in another state than that of the node"""
LOOKED_AT = 2000
"""Number of answers by which parameters are doubted; it bounds the time"""
NAMES = ["stamp", "penetration_depth", "status"]


class HeldAnswers:
    """Keeps computed answers, and compares them with those in the bag."""

    def __init__(self) -> None:
        """Begin without answers."""
        self._computed: list[Rows] = []
        self._number = 0

    def add_block(self, block: AnswerBlock) -> None:
        """Keep the answers of the only or medial compartment."""
        if self._number < MOST_COMPARED:
            self._computed.append(block.rows[0][NAMES].copy())
            self._number += len(block.rows[0])

    def difference(self, bag: Bag, names: Names) -> str:
        """Sentence that the answers in a bag are others than the computed ones; empty without such a difference."""
        topics = answer_topics(bag)
        wanted = absolute(KNEE_CONTACT, names.get(NAMESPACE, ""))
        topic = wanted if wanted in topics else topics[0] if len(topics) == 1 else ""
        if not topic or not self._computed or bag.damage:
            return ""
        held: list[Rows] = []
        try:
            for rows in answer_blocks(bag, topic):
                held.append(rows[NAMES].copy())
                if sum(map(len, held)) >= MOST_COMPARED:
                    break
        except UsageError as error:
            return str(error)
        return _difference(bag, topic, np.concatenate(held), np.concatenate(self._computed))


def doubt_of(bag: Bag, topic: str, model: KneeModel) -> str:
    """Sentence that the answers on a topic of a bag, the first ones, are not those of a model; empty if they are."""
    held = next(answer_blocks(bag, topic), None)
    if held is None:
        return ""
    breaks = np.flatnonzero((held["status"][1:] & Status.TIME_RESET) != 0)
    held = held[: min(LOOKED_AT, *(breaks[:1] + 1).tolist(), len(held))]
    heights = held["femoral_height"] if model.height_prescribed else None
    inputs = (held["stamp"], held["flexion_angle"], held["load"], heights)
    try:
        return _difference(bag, topic, held, model.stream().advance_all(*inputs))
    except ValueError:  # such inputs are no model's
        return ""


def _difference(bag: Bag, topic: str, held: Rows, computed: Rows) -> str:
    """Sentence that answers of equal stamps differ."""
    _, ours, theirs = np.intersect1d(computed["stamp"], held["stamp"], return_indices=True)
    usable = ((computed["status"][ours] | held["status"][theirs]) & UNUSABLE) == 0
    depth = computed["penetration_depth"][ours][usable]
    other = held["penetration_depth"][theirs][usable]
    if not len(depth):
        return ""
    limit = max(LEAST_DIFFERENCE, LARGEST_DIFFERENCE * float(max(depth.max(), other.max())))
    number = int(np.count_nonzero(np.abs(depth - other) > limit))
    if number <= FEW * len(depth):
        return ""
    return (
        f"bag {bag} holds answers of other parameters or inputs on {topic}: {number} of {len(depth)} depths differ; "
        f"the largest is {MM * other.max():.4f} mm there and {MM * depth.max():.4f} mm here; if another tool has "
        "rewritten it, its parameters are lost: give them with --params"
    )
