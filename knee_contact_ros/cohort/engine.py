"""A study on Dask: blocks of cases go to workers, and each writes its results where they belong.

The client keeps numbers of cases, no results: whatever is killed, what is written stays, and the next run computes the
rest. Two clients may share a folder.
"""

from __future__ import annotations

import ast
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from functools import lru_cache
from pathlib import Path
from typing import Any, NamedTuple

import fsspec
from dask import config
from distributed import Client, LocalCluster, as_completed
from distributed.scheduler import KilledWorker

from knee_contact_ros.bags.provenance import bag_digest
from knee_contact_ros.cohort.computing import compute
from knee_contact_ros.cohort.keys import case_key, common_digest, shard_name
from knee_contact_ros.cohort.knees import Knees, knees_in
from knee_contact_ros.cohort.shards import Shards
from knee_contact_ros.cohort.study import Case, Study
from knee_contact_ros.cohort.table import series_of, table_of
from knee_contact_ros.parameters.curves import curve_files, curve_texts
from knee_contact_ros.parameters.reading import known_parameters, load_parameters, variations_of
from knee_contact_ros.parameters.schema import Parameters
from knee_contact_ros.system.errors import IncompleteError, UsageError

TICKS_A_BLOCK = 2_000_000
"""Of a block of cases: about a second of a worker"""
MOST_A_BLOCK = 2_000
WAITING = 4
"""Blocks that each worker has before it"""
LONG_AGO = 3600.0
"""[s] after which an unfinished file is nobody's any more"""


class Done(NamedTuple):
    """What became of a study's cases."""

    there: int
    """That had been computed before"""
    computed: int
    failed: int
    """Of those computed now"""


class Keyed(NamedTuple):
    """Cases of one recording and one knee, their numbers following each other."""

    case: Case
    """The first of them"""
    number: int
    """Its number"""
    path: Path
    """Where the recording lies here"""
    keys: list[str]


class _Block(NamedTuple):
    """Cases of one recording and one knee."""

    bag: str
    params: tuple[str, ...]
    numbers: tuple[int, ...]
    keys: tuple[str, ...]


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
    shards = Shards(output)
    shards.refuse_others()
    there = shards.finished()
    blocks, kept = _missing(study, there)
    shards.note(study.content)
    computed = failed = 0
    if blocks:
        with _client(workers, scheduler) as client:
            for count, bad in _finished(client, study, output, blocks):
                computed, failed = computed + count, failed + bad
                advance(kept + computed, study.number)
    shards.sweep_up(LONG_AGO)
    return Done(kept, computed, failed)


def keyed(study: Study) -> Iterator[Keyed]:
    """The keys of all cases, in the order of their numbers.

    Raises:
        UsageError: bag or parameters cannot be used.
    """
    for number in range(0, study.number, study.variants):
        case = study.case(number)
        path = local_path(case.bag)
        parameters = load_parameters([*case.params, study.values])
        try:
            bag = bag_digest(path)
        except OSError as error:
            raise UsageError(f"cannot read bag {path}: {error.strerror or error}") from None
        common, varied = _common(bag, study), variations_of(parameters)
        keys = []
        for one in range(number, number + study.variants):
            values = study.case(one).values
            try:
                made = varied(values)
            except UsageError:
                made = None
            keys.append(case_key(common(made or parameters), made, values))
        yield Keyed(case, number, path, keys)


def _common(bag: str, study: Study) -> Callable[[Parameters], bytes]:
    """What goes into a case's key beside its parameters: those may name other files than the study's own."""
    known: dict[Any, bytes] = {}
    differ = any(isinstance(known_parameters()[name].default, str) for name in study.names)

    def common(parameters: Parameters) -> bytes:
        names = tuple(curve_files(parameters).items()) if differ or not known else next(iter(known))
        if names not in known:
            try:
                texts = curve_texts(parameters, {})
            except UsageError:
                if not differ:
                    raise
                texts = {}  # the case will fail
            known[names] = common_digest(bag, texts)
        return known[names]

    return common


def _missing(study: Study, there: set[str]) -> tuple[list[_Block], int]:
    """The cases that are not there, each once, in blocks; and how many need not be computed."""
    blocks, kept, known = [], 0, set(there)
    for own in keyed(study):
        missing = []
        for number, key in enumerate(own.keys, own.number):
            if key in known:
                kept += 1
            else:
                known.add(key)
                missing.append((number, key))
        size = max(1, min(MOST_A_BLOCK, TICKS_A_BLOCK // _ticks_in(own.path)))
        for begin in range(0, len(missing), size):
            numbers, keys = zip(*missing[begin : begin + size], strict=True)
            blocks.append(_Block(own.case.bag, own.case.params, numbers, keys))
    return blocks, kept


def _ticks_in(path: Path) -> int:
    """About so many ticks that a bag has, by its size; 100 B a message and less."""
    size = (
        sum(file.stat().st_size for file in path.rglob("*") if file.is_file()) if path.is_dir() else path.stat().st_size
    )
    return max(1, size // 100)


def local_path(bag: str) -> Path:
    """Where a bag lies on this machine: a copy is fetched of one that lies elsewhere.

    Raises:
        UsageError: it is not there, or its address means nothing.
    """
    if "://" not in bag:
        path = Path(bag).expanduser()
        if not path.exists():
            raise UsageError(f"no bag at {path}: give an .mcap file or a rosbag2 folder")
        return path
    try:
        (copy,) = fsspec.open_local([f"simplecache::{bag}"])
    except (ValueError, ImportError, OSError) as error:
        raise UsageError(f"bag {bag}: cannot be fetched: {error or type(error).__name__}") from None
    return Path(copy)


@contextmanager
def _client(workers: int, scheduler: str) -> Iterator[Client]:
    """A client of a scheduler that is there, or of processes of this machine, which end with it."""
    quiet = {"distributed.logging.distributed": "error", "distributed.comm.retry.count": 2}
    if scheduler:
        try:
            client = Client(scheduler, timeout=10, set_as_default=False)
        except (OSError, ValueError, TypeError) as error:
            raise UsageError(f"scheduler {scheduler}: cannot be reached: {error}") from None
        with client:
            yield client
        return
    with (
        config.set(quiet),
        LocalCluster(
            n_workers=workers or None, threads_per_worker=1, processes=True, host="127.0.0.1",
            dashboard_address="127.0.0.1:0", scheduler_kwargs={"dashboard": False}, silence_logs=50,
        ) as cluster,
        Client(cluster, set_as_default=False) as client,
    ):  # fmt: skip
        yield client


def _finished(client: Client, study: Study, output: str, blocks: Sequence[_Block]) -> Iterator[tuple[int, int]]:
    """How many cases each block has, and how many of them failed, as they come."""
    rest = iter(blocks)
    told = client.scatter(study, broadcast=True, hash=False)
    threads = sum(client.nthreads().values()) or 1

    def submit(block: _Block) -> Any:
        return client.submit(compute_block, told, block, output, study.number, pure=False, retries=0)

    first = [submit(block) for _, block in zip(range(WAITING * threads), rest, strict=False)]
    running = as_completed(first, loop=client.loop)
    for future in running:
        try:
            yield future.result()
        except KilledWorker as error:
            raise IncompleteError(f"workers died again and again: {error}") from None
        except OSError as error:
            raise IncompleteError(f"{error.filename or output}: {error.strerror or error}") from None
        future.release()
        for block in rest:
            running.add(submit(block))
            break


def compute_block(study: Study, block: _Block, output: str, in_all: int) -> tuple[int, int]:
    """What a worker does: compute a block and write it; how many cases there were, and how many of them failed."""
    shards, name = Shards(output), shard_name(list(block.keys))
    if shards.holds(name):  # another client's work
        return len(block.keys), 0
    knees = _knees(block.bag, block.params, repr(dict(study.values)))
    cases = [study.case(number).values for number in block.numbers]
    computed = compute(knees, cases, series=study.series, in_all=in_all)
    table = table_of(block.keys, block.bag, block.params, knees, cases, computed)
    shards.write(name, table, series_of(block.keys, computed) if study.series else None)
    return len(computed), sum(bool(one.failed) for one in computed)


@lru_cache(8)
def _knees(bag: str, params: tuple[str, ...], values: str) -> Knees:
    return knees_in(local_path(bag), list(params), ast.literal_eval(values))
