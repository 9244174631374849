"""What a worker does: it is told all of a block of cases but the recording, computes it and writes it where it belongs.

It reads nothing but the bag: parameters come as values, and the files that they name as texts.
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
    """What the cases of a block have in common."""

    bag: str
    """Where it lies, for whoever reads it"""
    digest: str
    """Of the bag"""
    values: str
    """All parameters, as JSON"""
    files: tuple[tuple[str, str], ...]
    """Names and contents of the files that parameters name"""


class Aim(NamedTuple):
    """Of all blocks of a study."""

    output: str
    note: str
    """A file that lies there"""
    run: str
    series: bool
    cases: int
    """In all"""
    answers: str
    """What the client's model is: `what_answers`"""


class Block(NamedTuple):
    """Cases of one recording and one knee."""

    aim: Aim
    source: Source
    labels: tuple[str, tuple[str, ...]]
    """Bag and parameter files, as the study names them"""
    names: tuple[str, ...]
    """Of what is varied"""
    rows: tuple[tuple[Any, ...], ...]
    """Values of each case"""
    keys: tuple[str, ...]
    name: str
    """Of its shard"""


class Told(NamedTuple):
    """What became of a block."""

    computed: int
    failed: int
    damage: tuple[str, ...]
    """What of the bag cannot be read, as sentences"""


def compute_block(block: Block) -> Told:
    """Compute a block and write it; nothing is computed of one that has been written meanwhile.

    By another client, or for this one, by a worker that died before it could tell.

    Raises:
        UsageError: bag or folder cannot be used, or this is another version of the model.
        IncompleteError: the disk is full.
    """
    aim, (bag, params) = block.aim, block.labels
    if aim.answers != what_answers():
        raise UsageError(f"worker {_own_address()}: another version of knee_contact_ros than here; install the same")
    shards = Shards(aim.output, aim.run)
    if not shards.knows(aim.note):
        raise UsageError(f"output {aim.output}: worker {_own_address()} does not see this folder; one that all share")
    if shards.holds(block.name, series=aim.series):
        ours, failed = shards.by_whom(block.name)
        return Told(len(block.keys), failed, ()) if ours else Told(0, 0, ())
    knees = _knees(block.source)
    cases = [dict(zip(block.names, row, strict=True)) for row in block.rows]
    computed = compute(knees, cases, series=aim.series, in_all=aim.cases)
    table = table_of(block.keys, bag, params, knees, cases, computed)
    try:
        shards.write(table, series_of(block.keys, computed) if aim.series else None)
    except OSError as error:
        raise shards.told(error) from None
    _settle()
    return Told(len(computed), sum(bool(one.failed) for one in computed), knees.recording.damage)


@lru_cache(4)
def _knees(source: Source) -> Knees:
    with here(source.bag) as path:
        found = digest_of(source.bag, path)
        if found != source.digest:
            raise UsageError(f"bag {source.bag}: worker {_own_address()} finds another content than the client")
        return knees_in(path, load_parameters(json.loads(source.values)), Files(dict(source.files)))


@cache
def _settle() -> None:
    """Once the first block is done and all is loaded, spare it the garbage collector: thousands of cases call for that.

    To look through all that the compiler consists of takes a quarter of a second each time.
    """
    gc.freeze()


def _own_address() -> str:
    from distributed import get_worker

    try:
        return str(get_worker().address)
    except ValueError:
        return "here"
