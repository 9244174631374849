"""A study on Dask: the client sends blocks of cases to workers, and each worker writes its results into the folder.

The client holds keys of cases and no results. Whatever process is killed, written results stay, and the next run
computes the rest. Several clients may share a folder.
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
from knee_contact_ros.cohort.work import Target

LONG_AGO = 3600.0
"""Age [s] from which on an unfinished file of another run is removed: nobody is writing it any more"""


class Done(NamedTuple):
    """How many cases of a study were computed, and how many were not."""

    there: int
    """Cases that had been computed before, or by another client meanwhile, or that are the same as another case"""
    computed: int
    """Cases that were computed now"""
    failed: int
    """Cases among those computed now that have no outcome"""
    damage: tuple[str, ...]
    """Parts of the bags that cannot be read, a sentence each"""


def run_study(
    study: Study, output: str, *, workers: int = 0, scheduler: str = "", advance: Callable[[int, int], None]
) -> Done:
    """Compute the missing cases of a study.

    Args:
        study: The study.
        output: Folder of the results, local or as fsspec spells it.
        workers: Processes on this machine; 0: one for each processor.
        scheduler: Address of a scheduler whose workers compute instead, as `tcp://host:8786`.
        advance: Called with the number of cases that are done, and the number of all cases.

    Raises:
        UsageError: bag, parameters, folder or scheduler cannot be used.
        IncompleteError: a disk is full, or workers died again and again.
    """
    run = uuid.uuid4().hex[:12]
    shards = Shards(absolute(output), run)
    finished = shards.finished(series=study.series)
    knees = knees_of(study)
    note, text = note_of(study.content)
    target = Target(shards.url, note, run, study.series, study.number, what_answers())
    missing = Missing(study, knees, finished, target)
    blocks, count, failed = iter(missing), 0, 0
    damage: dict[str, None] = {}
    first = next(blocks, None)
    try:
        if first:
            with workers_of(workers, scheduler) as client:
                shards.make(note, text)
                for report in computed(client, itertools.chain([first], blocks)):
                    count, failed = count + report.computed, failed + report.failed
                    damage |= dict.fromkeys(report.damage)
                    advance(missing.there + count, study.number)
    finally:
        shards.sweep_up(LONG_AGO)
    shards.unite()
    return Done(study.number - count, count, failed, tuple(damage))
