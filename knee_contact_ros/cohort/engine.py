"""A study on Dask: blocks of cases go to workers, and each writes its results where they belong.

The client keeps keys of cases, no results: whatever is killed, what is written stays, and the next run computes the
rest. Two clients may share a folder.
"""

from __future__ import annotations

import itertools
import uuid
from collections.abc import Callable
from typing import NamedTuple

from knee_contact_ros.cohort.blocks import Missing, knees_of
from knee_contact_ros.cohort.cluster import computed, workers_of
from knee_contact_ros.cohort.keys import what_answers
from knee_contact_ros.cohort.places import absolute
from knee_contact_ros.cohort.shards import Shards, note_of
from knee_contact_ros.cohort.study import Study
from knee_contact_ros.cohort.work import Aim

LONG_AGO = 3600.0
"""[s] after which an unfinished file is nobody's any more"""


class Done(NamedTuple):
    """What became of a study's cases."""

    there: int
    """That had been computed before, or by others meanwhile, or are the same as another one"""
    computed: int
    failed: int
    """Of those computed now"""
    damage: tuple[str, ...]
    """What of the bags cannot be read, as sentences"""


def run_study(
    study: Study, output: str, *, workers: int = 0, scheduler: str = "", advance: Callable[[int, int], None]
) -> Done:
    """Compute what is missing of a study.

    Args:
        study: What is asked.
        output: Folder of the results, local or as fsspec spells it.
        workers: Processes on this machine; 0: one for each processor.
        scheduler: Address of a scheduler whose workers compute instead, as `tcp://host:8786`.
        advance: Is told how many cases are done, and how many there are.

    Raises:
        UsageError: bag, parameters, folder or scheduler cannot be used.
        IncompleteError: a disk is full, or workers died again and again.
    """
    run = uuid.uuid4().hex[:12]
    shards = Shards(absolute(output), run)
    there = set(shards.finished(series=study.series))
    knees = knees_of(study)
    note, text = note_of(study.content)
    missing = Missing(study, knees, there, Aim(shards.url, note, run, study.series, study.number, what_answers()))
    blocks, count, failed = iter(missing), 0, 0
    damage: dict[str, None] = {}
    first = next(blocks, None)
    try:
        if first:
            with workers_of(workers, scheduler) as client:
                shards.make(note, text)
                for told in computed(client, itertools.chain([first], blocks)):
                    count, failed = count + told.computed, failed + told.failed
                    damage |= dict.fromkeys(told.damage)
                    advance(missing.there + count, study.number)
    finally:
        shards.sweep_up(LONG_AGO)
    shards.unite()
    return Done(study.number - count, count, failed, tuple(damage))
