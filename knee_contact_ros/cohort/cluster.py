"""Workers: processes of this machine, or those of a Dask scheduler. Their failures become errors of one line."""

from __future__ import annotations

import logging
import signal
import time
from collections.abc import Iterable, Iterator
from concurrent.futures import CancelledError
from contextlib import ExitStack, contextmanager
from multiprocessing import resource_tracker
from typing import Any

from dask import config
from distributed import Client, LocalCluster, as_completed
from distributed.comm import CommClosedError
from distributed.scheduler import KilledWorker

from knee_contact_ros.cohort.places import reason
from knee_contact_ros.cohort.work import Block, Report, compute_block
from knee_contact_ros.system.errors import IncompleteError, ToldError, UsageError
from knee_contact_ros.system.terminal import warn

PATIENCE = 10.0
"""Time [s] that a scheduler has to answer"""
WAITING = 4
"""Blocks that are submitted per thread of the workers"""
LEAST_WAITING = 32
"""The least number of blocks that are submitted: so a cluster that scales itself sees that there is work"""
LOOK = 2.0
"""Time [s] after which the workers are counted again"""
REST = "what is finished stays, and the rest is computed by the same command"
LOGS = ("distributed", "tornado", "asyncio")
GONE = f"the scheduler is gone; {REST}"
QUIET: dict[str, object] = {f"logging.{name}": "critical" for name in LOGS} | {
    f"distributed.{part}.http.routes": [] for part in ("scheduler", "worker", "nanny")
}
"""Dask settings by which a cluster writes no log and serves no web page"""
QUICK: dict[str, object] = {
    "distributed.nanny.pre-spawn-environ.MALLOC_TRIM_THRESHOLD_": None, "distributed.worker.profile.enabled": False
}  # fmt: skip
"""Dask settings by which workers keep freed memory that they need again soon, and are not sampled by a profiler"""


@contextmanager
def workers_of(number: int, scheduler: str) -> Iterator[Client]:
    """Connect to a running scheduler, or start workers on this machine, which end with the context.

    Args:
        number: Processes on this machine; 0: one for each processor.
        scheduler: Address of the scheduler to use instead; empty for workers on this machine.

    Raises:
        UsageError: the scheduler cannot be reached.
        IncompleteError: no process can be started.
    """
    with ExitStack() as opened:
        opened.enter_context(config.set(QUIET | QUICK))
        for name in [name for name in logging.root.manager.loggerDict if name.startswith(LOGS)]:
            logging.getLogger(name).setLevel(logging.CRITICAL)
        if scheduler:
            yield opened.enter_context(_reached(scheduler))
            return
        try:
            with _ignoring_interrupts():
                cluster = LocalCluster(
                    n_workers=number or None, threads_per_worker=1, processes=True, host="127.0.0.1",
                    dashboard_address=None, silence_logs=logging.CRITICAL,
                    scheduler_kwargs={"dashboard": False, "dashboard_address": "127.0.0.1:0"},
                )  # fmt: skip
                opened.enter_context(cluster)
            client = opened.enter_context(Client(cluster, set_as_default=False))
        except (OSError, RuntimeError) as error:
            raise IncompleteError(f"no workers can be started: {reason(error)}") from None
        yield client


@contextmanager
def _ignoring_interrupts() -> Iterator[None]:
    """Let processes and threads that are started in this context ignore Ctrl-C: the client gets it, and ends them."""
    resource_tracker.ensure_running()  # it lets the signal through again in the thread that it is started by
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _reached(scheduler: str) -> Client:
    try:
        client = Client(scheduler, timeout=PATIENCE, set_as_default=False)
    except Exception as error:  # a boundary: an address may be of a kind that needs another library
        raise UsageError(f"scheduler {scheduler}: cannot be reached: {reason(error)}") from None
    if not client.nthreads():
        warn([f"scheduler {scheduler}: it has no workers yet, and is waited for"])
    return client


def computed(client: Client, blocks: Iterable[Block]) -> Iterator[Report]:
    """Have blocks computed by the workers, and yield a report of each block as it is done.

    Raises:
        UsageError: a worker cannot use bag or folder.
        IncompleteError: the disk is full, workers died again and again, or the scheduler is gone.
    """
    rest, running, wanted, looked = iter(blocks), as_completed(loop=client.loop), LEAST_WAITING, -LOOK
    of_future: dict[str, Block] = {}
    while True:
        if time.monotonic() - looked > LOOK:
            wanted, looked = max(LEAST_WAITING, WAITING * _threads(client)), time.monotonic()
        while len(of_future) < wanted and (block := next(rest, None)):
            future = _submitted(client, block)
            of_future[future.key] = block
            running.add(future)
        if not of_future:
            return
        future = next(running)
        block = of_future.pop(future.key)
        yield _result(future, block)
        future.release()


def _submitted(client: Client, block: Block) -> Any:
    try:
        return client.submit(compute_block, block, pure=False, retries=0)
    except Exception:  # a boundary: a client that has lost its scheduler says so in several ways
        raise IncompleteError(GONE) from None


def _threads(client: Client) -> int:
    try:
        return sum(client.nthreads().values())
    except Exception:  # a boundary: a scheduler that is gone shows in what it was to do
        return 0


def _result(future: Any, block: Block) -> Report:
    try:
        report: Report = future.result()
    except (ToldError, KeyboardInterrupt):
        raise
    except KilledWorker:
        where = f"{len(block.keys)} cases of bag {block.bag}"
        raise IncompleteError(f"workers died again and again at {where}: of too little memory? {REST}") from None
    except (CancelledError, CommClosedError):
        raise IncompleteError(GONE) from None
    except Exception as error:  # a boundary: whatever a worker may lack or meet
        failure = f"{type(error).__name__}: {reason(error)}"
        raise IncompleteError(f"bag {block.bag}: a worker failed: {failure}; {REST}") from None
    return report
