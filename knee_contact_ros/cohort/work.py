"""The work of a worker: compute a block of cases, and write the results into the folder of the study.

The worker reads nothing but the bag: a block has the parameters as values, and the files that they name as texts.
"""

from __future__ import annotations

import gc
import json
from functools import cache, lru_cache
from typing import Any, NamedTuple

from knee_contact_ros.cohort.computing import compute
from knee_contact_ros.cohort.keys import what_answers
from knee_contact_ros.cohort.knees import Files, Knees, knees_in
from knee_contact_ros.cohort.places import digest_of, here
from knee_contact_ros.cohort.shards import Shards
from knee_contact_ros.cohort.table import series_of, table_of
from knee_contact_ros.parameters.reading import load_parameters
from knee_contact_ros.system.errors import UsageError


class Source(NamedTuple):
    """The recording and the parameters that the cases of a block have in common."""

    bag: str
    """Absolute path or address of the bag"""
    digest: str
    """SHA-256 of the bag's content"""
    values: str
    """All parameters, as JSON"""
    files: tuple[tuple[str, str], ...]
    """Names and contents of the files that parameters name"""


class Target(NamedTuple):
    """What all blocks of a study have in common: where the results go, and what they consist of."""

    output: str
    """Absolute path or address of the folder of results"""
    note: str
    """Name of a file in that folder, by which a worker sees that it is the same one"""
    run: str
    """Random name of the run of the client"""
    series: bool
    """Whether all answers of every case are kept, too"""
    cases: int
    """Number of cases of the whole study"""
    answers: str
    """Digest of the client's model, see `what_answers`"""


class Block(NamedTuple):
    """Cases of one recording and one set of parameter files, which a worker computes together."""

    target: Target
    source: Source
    bag: str
    """The bag as the study names it"""
    params: tuple[str, ...]
    """The parameter files as the study names them"""
    names: tuple[str, ...]
    """Names of the parameters that are varied"""
    rows: tuple[tuple[Any, ...], ...]
    """Values of these parameters, a row for each case"""
    keys: tuple[str, ...]
    """Keys of the cases, see `case_key`"""
    name: str
    """Name of the file that gets the results"""


class Report(NamedTuple):
    """What a worker reports of a block."""

    computed: int
    """Number of cases that were computed"""
    failed: int
    """Number of these cases that have no outcome"""
    damage: tuple[str, ...]
    """Parts of the bag that cannot be read, a sentence each"""


def compute_block(block: Block) -> Report:
    """Compute a block and write it, unless its file exists already.

    Another client may have written it meanwhile; or a worker of this client, which died before it could report.

    Raises:
        UsageError: bag or folder cannot be used, or this is another version of the model.
        IncompleteError: the disk is full.
    """
    target = block.target
    if target.answers != what_answers():
        raise UsageError(f"worker {_own_address()}: another version of knee_contact_ros than here; install the same")
    shards = Shards(target.output, target.run)
    if not shards.has_note(target.note):
        raise UsageError(
            f"output {target.output}: worker {_own_address()} does not see this folder; one that all share"
        )
    if shards.holds(block.name, series=target.series):
        ours, failed = shards.by_whom(block.name)
        return Report(len(block.keys), failed, ()) if ours else Report(0, 0, ())
    knees = _knees(block.source)
    cases = [dict(zip(block.names, row, strict=True)) for row in block.rows]
    computed = compute(knees, cases, series=target.series, in_all=target.cases)
    table = table_of(block.keys, block.bag, block.params, knees, cases, computed)
    try:
        shards.write(table, series_of(block.keys, computed) if target.series else None)
    except OSError as error:
        raise shards.error_of(error) from None
    _freeze()
    return Report(len(computed), sum(bool(one.failed) for one in computed), knees.recording.damage)


@lru_cache(4)
def _knees(source: Source) -> Knees:
    with here(source.bag) as path:
        if digest_of(source.bag, path) != source.digest:
            raise UsageError(f"bag {source.bag}: worker {_own_address()} finds another content than the client")
        return knees_in(path, load_parameters(json.loads(source.values)), Files(dict(source.files)))


@cache
def _freeze() -> None:
    """Exempt all that is loaded from garbage collection, once the first block is done.

    Thousands of cases start many collections, and each takes a quarter of a second for the compiler's objects.
    """
    gc.freeze()


def _own_address() -> str:
    from distributed import get_worker

    try:
        return str(get_worker().address)
    except ValueError:
        return "here"
