"""A study: all combinations of bags, parameter files and varied values, computed by Dask block by block.

Workers read bags and send tables back; only the client writes. Every block becomes a Parquet file of the output folder.
"""

import itertools
import logging
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from typing import Any, NamedTuple

from ..model.ringing import ringing_sentence
from ..system.errors import CommandError, IncompleteError, UsageError
from ..system.processes import ignoring_interrupts
from ..system.progress import progress
from ..system.terminal import say, warn
from .shards import SERIES_FOLDER, ShardFolder, brief_reason
from .study_cases import (
    BlockResult,
    CaseBlock,
    blocks_of,
    compute_block,
    groups_of,
    short_digest,
)
from .study_file import Study

SCHEDULER_TIMEOUT = 10.0
"""Time [s] that a scheduler has to answer"""
BLOCKS_A_THREAD = 4
"""Blocks submitted per thread of the workers, so that a cluster that scales itself sees the work waiting"""
HOW_TO_GO_ON = "finished cases are kept; the same command computes the rest"
NOISY_LOGGERS = ("distributed", "tornado", "asyncio")
DASK_SETTINGS: dict[str, object] = (
    {f"logging.{name}": "critical" for name in NOISY_LOGGERS}
    | {f"distributed.{part}.http.routes": [] for part in ("scheduler", "worker", "nanny")}
    | {
        "distributed.nanny.pre-spawn-environ.MALLOC_TRIM_THRESHOLD_": None,
        "distributed.worker.profile.enabled": False,
    }
)
"""No logs, no web page, no profiler, and workers keep freed memory that they soon need again"""


@contextmanager
def dask_client(number: int, scheduler: str) -> Iterator[Any]:
    """Connect to a running scheduler, or start workers on this machine until the context ends; yield the client.

    Args:
        number: Processes on this machine; 0: one for each processor.
        scheduler: Address of the scheduler to use instead; empty for workers on this machine.

    Raises:
        UsageError: the scheduler cannot be reached.
        IncompleteError: no process can be started.
    """
    # Import before the settings are changed: it adds its own, which must outlive the context.
    from dask import config
    from distributed import Client, LocalCluster
    from distributed.comm import parse_address
    from distributed.comm.registry import get_backend

    with ExitStack() as opened:
        opened.enter_context(config.set(DASK_SETTINGS))
        for name in [*logging.root.manager.loggerDict]:
            if name.startswith(NOISY_LOGGERS):
                logging.getLogger(name).setLevel(logging.CRITICAL)
        try:
            if scheduler:
                # A client of an unknown kind of address would wait for it when the context ends.
                get_backend(parse_address(scheduler)[0])
            with ignoring_interrupts():
                cluster = scheduler or opened.enter_context(
                    LocalCluster(
                        n_workers=number or None,
                        threads_per_worker=1,
                        processes=True,
                        host="127.0.0.1",
                        dashboard_address=None,
                        silence_logs=logging.CRITICAL,
                        scheduler_kwargs={"dashboard": False, "dashboard_address": "127.0.0.1:0"},
                    )
                )
            client = Client(cluster, timeout=SCHEDULER_TIMEOUT, set_as_default=False)
            opened.enter_context(client)
        except Exception as error:  # a boundary: a kind of address may need another library
            if scheduler:
                fault = f"scheduler {scheduler}: cannot be reached: {brief_reason(error)}"
                raise UsageError(fault) from None
            raise IncompleteError(f"no workers can be started: {brief_reason(error)}") from None
        if scheduler and not client.nthreads():
            warn([f"scheduler {scheduler}: it has no workers yet; waiting"])
        yield client


def compute_blocks(
    client: Any, blocks: Iterator[CaseBlock]
) -> Iterator[tuple[CaseBlock, BlockResult]]:
    """Let the workers compute blocks; yield each with its result when it is done.

    Raises:
        UsageError: a worker cannot use a bag.
        IncompleteError: workers died repeatedly or failed, or the scheduler is gone.
    """
    from distributed import as_completed
    from distributed.scheduler import KilledWorker

    running = as_completed(loop=client.loop)
    block_of_future = dict[str, CaseBlock]()
    future = None

    def submit() -> None:
        wanted = BLOCKS_A_THREAD * max(8, sum(client.nthreads().values())) - len(block_of_future)
        for block in itertools.islice(blocks, max(0, wanted)):
            submitted = client.submit(compute_block, block, pure=False)
            block_of_future[submitted.key] = block
            running.add(submitted)

    try:
        submit()
        for future in running:
            block = block_of_future.pop(future.key)
            result = future.result()
            future.release()
            yield block, result
            submit()
    except CommandError:
        raise
    except KilledWorker:
        where = f"{len(block.keys)} cases of bag {block.bag}"
        raise IncompleteError(
            f"workers died repeatedly at {where}: is there too little memory? {HOW_TO_GO_ON}"
        ) from None
    except Exception as error:  # a boundary: whatever a worker may lack or meet
        if future is None or future.status != "error":
            raise IncompleteError(f"the scheduler no longer answers; {HOW_TO_GO_ON}") from None
        failure = f"{type(error).__name__}: {brief_reason(error)}"
        raise IncompleteError(
            f"bag {block.bag}: a worker failed: {failure}; {HOW_TO_GO_ON}"
        ) from None


class StudyRun(NamedTuple):
    """How many cases of a study were computed, and what is missing."""

    known: int
    """Number of cases that were there before, or are the same as another one"""
    computed: int
    """Number of cases that were computed now"""
    failed: int
    """Number of all cases that have no outcome"""
    missing: str
    """What is missing of the work; empty if it is whole"""


def run_study(study: Study, output: str, workers: int = 0, scheduler: str = "") -> StudyRun:
    """Compute the missing cases of a study, with a bar, and say how many there were.

    Args:
        study: The study.
        output: Folder of the results, local or as fsspec spells it.
        workers: Processes on this machine; 0: one for each processor.
        scheduler: Address of a scheduler whose workers compute instead, as `tcp://host:8786`.

    Raises:
        UsageError: bag, parameters, folder or scheduler cannot be used.
        IncompleteError: a disk is full, or workers died repeatedly.
    """
    computed, ringing = 0, 0.0
    failures = list[str]()
    used = set[str]()
    shards = ShardFolder(output)
    with progress("Computing") as advance:
        groups = groups_of(study)
        known = dict(shards.read_columns("failed").get("failed", {}))
        if study.series:
            _check_series(shards)
        doubts = {f"bag {group.bag}: {doubt}": None for group in groups for doubt in group.doubts}
        blocks = blocks_of(study, groups, known, used)
        # A study that is complete starts no worker.
        if first := next(blocks, None):
            with dask_client(workers, scheduler) as client:
                for block, result in compute_blocks(client, itertools.chain([first], blocks)):
                    name = f"cases-{short_digest(' '.join(block.keys))}.parquet"
                    if study.series:
                        shards.write_file(f"{SERIES_FOLDER}/{name}", result.series)
                    shards.write_file(name, result.table)
                    computed += len(block.keys)
                    failures += result.failures
                    ringing = max(ringing, result.ringing)
                    doubts |= {f"bag {block.bag}: {doubt}": None for doubt in result.doubts}
                    advance(computed, study.number)
    warn([*doubts, *([f"of some cases {ringing_sentence(ringing)}"] if ringing else [])])
    failures += [known[key] for key in used if known.get(key)]
    there = len(used) - computed
    same = study.number - len(used)
    others = f"{same} the same as others, " if same else ""
    say(
        f"{study.number} cases: {computed} computed, {there} were there already, "
        f"{others}{len(failures)} failed"
    )
    missing = [f"{len(failures)} of {len(used)} cases failed: {min(failures)}"] if failures else []
    missing += [
        f"bag {group.bag} is damaged, and computed as far as it can be read: {group.damage}"
        for group in groups
        if group.damage
    ]
    return StudyRun(there + same, computed, len(failures), "; ".join(dict.fromkeys(missing)))


def _check_series(shards: ShardFolder) -> None:
    """Refuse cases without their series, and remove series without their cases, which are computed again.

    Raises:
        UsageError: the folder holds cases without their series.
    """
    cases = set(shards.shard_names())
    series = set(shards.shard_names(SERIES_FOLDER))
    if cases - series:
        raise UsageError(
            f"output {shards.url}: holds cases without their series; use a new folder"
        )
    for name in series - cases:
        shards.remove_file(f"{SERIES_FOLDER}/{name}")
