"""A study on Dask: blocks of cases are computed by workers, each of which writes its table into the folder.

The client holds keys of cases and no results. Whatever process is killed, written results stay, and the next run
computes the rest. Only one client at a time works on a folder.

The folder is a Parquet dataset of files (shards) that appear whole, named by their content. Readers of Parquet datasets
pass over names that begin with an underscore: so do incomplete files begin, and the folder of all answers. The folder
may lie wherever fsspec can write. A row has a column for every parameter that a study may vary: so tables of several
studies fit together, and every row describes its knee completely.
"""

from __future__ import annotations

import errno
import gc
import hashlib
import itertools
import json
import logging
import os
import re
import signal
import time
import uuid
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager, suppress
from functools import cache, lru_cache, reduce
from multiprocessing import resource_tracker
from operator import attrgetter, getitem
from pathlib import Path, PurePosixPath
from tempfile import TemporaryDirectory
from typing import Any, NamedTuple

import fsspec
import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq
from dask import config
from distributed import Client, LocalCluster, as_completed, get_worker
from distributed.scheduler import KilledWorker
from fsspec.implementations.local import LocalFileSystem

from knee_contact_ros.bags.provenance import bag_digest, model_digest, weight_of
from knee_contact_ros.lab.study import Case, Study, read_study
from knee_contact_ros.lab.sweep import LATERAL, OUTCOMES, Computed, Knees, compute, file_texts, may_vary, read_recording
from knee_contact_ros.model.compiler import worth_compiling
from knee_contact_ros.model.types import FLAT, TOLD
from knee_contact_ros.offline.solve import with_weight
from knee_contact_ros.parameters.files import all_values, known_parameters, load_parameters, read_curve, variations_of
from knee_contact_ros.parameters.schema import LATERAL as LATERAL_KNEE
from knee_contact_ros.parameters.schema import Parameters, has_both
from knee_contact_ros.system.errors import IncompleteError, ToldError, UsageError
from knee_contact_ros.system.files import expanded
from knee_contact_ros.system.terminal import progress, say, warn

ADDRESS = re.compile("://|::")
"""What makes a name an address that fsspec opens (`s3://...`, `zip://gait.mcap::https://...`), and no path"""
DIGITS = 32
"""Number of hexadecimal digits of a key"""
NOT_COUNTED = {"autostart", "deadline", "diagnostics", "record", "rerun"}
"""Sections of the parameters that change no answer, and so no key"""
MEANING = 1
"""Version of the outcomes' definitions: to be increased when a column is computed in another way"""
SERIES, UNFINISHED, STUDY = "_series", "_unfinished-", "_study-"
"""Names in the folder of a study: the folder of all answers, and beginnings of those of files"""
FULL = {errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EIO}
"""Errors that are no fault of the user's"""
LONG_AGO = 3600.0
"""Age [s] from which on an unfinished file of another run is removed: nobody is writing it any more"""
TYPES = {float: pa.float64(), int: pa.int64(), bool: pa.bool_(), str: pa.string()}
BEFORE = (
    ("case", pa.string(), "key of the case: a digest of bag, parameters and model"),
    ("bag", pa.string(), "as the study names it"),
    ("params", pa.string(), "parameter files, as the study names them"),
)
AFTER = (
    ("failed", pa.string(), "why there is no outcome; empty if there is one"),
    ("seconds", pa.float64(), "[s] that the case took, one of many computed together"),
)
TICKS_A_BLOCK = 800_000
"""Ticks of a block: more than a tenth of a second of a worker's time, ten times the overhead of a block"""
LEAST, PARTS = 8, 16
"""The least number of cases in a block, and the number of blocks into which a small study is divided"""
NAME_FILES = (".profile", ".table", ".share_file")
"""Endings of the names of those parameters whose values are names of files"""
BYTES_A_TICK = 100
"""The most bytes that a tick takes in a compressed bag"""
PATIENCE = 10.0
"""Time [s] that a scheduler has to answer"""
WAITING, LEAST_WAITING = 4, 32
"""Blocks that are submitted per thread of the workers, and the least number of them: so a cluster that scales itself
sees that there is work"""
REST = "what is finished stays, and the rest is computed by the same command"
LOGS = ("distributed", "tornado", "asyncio")
DASK: dict[str, object] = {f"logging.{name}": "critical" for name in LOGS} | {
    f"distributed.{part}.http.routes": [] for part in ("scheduler", "worker", "nanny")
} | {
    "distributed.nanny.pre-spawn-environ.MALLOC_TRIM_THRESHOLD_": None, "distributed.worker.profile.enabled": False
}  # fmt: skip
"""Settings by which a cluster writes no log and serves no web page, and workers keep freed memory that they need again
soon, and are not sampled by a profiler"""


def absolute(name: str) -> str:
    """Make a path absolute, so that it means the same in every process; an address of fsspec stays as it is.

    Raises:
        UsageError: the name is empty, or has a zero byte.
    """
    if not name or "\0" in name:
        raise UsageError(f"{name!r} is not allowed; a path, or an address as s3://bucket/folder")
    return name if ADDRESS.search(name) else str(expanded(name).absolute())


@contextmanager
def here(place: str, bag: str) -> Iterator[tuple[Path, str]]:
    """Give the path of a bag on this machine and the SHA-256 of its content.

    Args:
        place: Absolute path or address of the bag. One behind an address is copied for the time of the context.
        bag: Its name for error messages.

    Raises:
        UsageError: the bag cannot be fetched or read.
    """
    with TemporaryDirectory(prefix="knee_contact_bag_") as folder:
        path = Path(place)
        if ADDRESS.search(place):
            try:
                files, inner = fsspec.core.url_to_fs(place)
                path = Path(folder) / (PurePosixPath(str(inner)).name or "bag")
                files.get(inner, str(path), recursive=bool(files.isdir(inner)))
            except Exception as error:  # a boundary: each kind of store has errors of its own
                raise UsageError(f"bag {place}: cannot be fetched: {reason(error)}") from None
        try:
            digest = bag_digest(path)
        except OSError as error:
            raise UsageError(f"bag {bag}: {reason(error)}") from None
        yield path, digest


def reason(error: BaseException) -> str:
    """Describe an error in few words."""
    return getattr(error, "strerror", None) or str(error) or type(error).__name__


@lru_cache
def what_answers() -> str:
    """Give a digest of the model's source and of the outcomes' definitions; every key depends on it."""
    names = [outcome.name for outcome in OUTCOMES]
    return _digest(repr((model_digest(), MEANING, names)))


def case_key(bag: str, parameters: Parameters, texts: Mapping[str, str]) -> str:
    """Make the key of a case.

    Args:
        bag: Digest of the recording.
        parameters: All parameters of the case.
        texts: Contents of the files that the parameters name, by parameter. The names of the files do not count.
    """
    left_out: set[str] = NOT_COUNTED if has_both(parameters) else NOT_COUNTED | {"lateral"}
    values = parameters.model_dump(exclude=left_out)
    for name in texts:
        *sections, last = name.split(".")
        reduce(getitem, sections, values).pop(last, None)
    contents = [f"{name} {_digest(text)}" for name, text in sorted(texts.items())]
    return _digest(f"{what_answers()} {bag} {values} {contents}")


@lru_cache(64)
def _digest(content: str) -> str:
    return hashlib.sha256(content.encode()).hexdigest()[:DIGITS]


@lru_cache
def schema() -> pa.Schema:
    """Give the names and types of the table's columns; their meanings are in the fields' metadata."""
    columns = [*BEFORE]
    for name, declared in known_parameters().items():
        if may_vary(name):
            columns.append((name, TYPES[type(declared.default)], declared.description))
    for prefix, compartment in (("", ""), (LATERAL, " of the lateral compartment")):
        for outcome in OUTCOMES:
            unit = f"[{outcome.unit}] " if outcome.unit else ""
            columns.append((prefix + outcome.name, pa.float64(), f"{unit}{outcome.meaning}{compartment}"))
    return pa.schema([pa.field(name, kind, metadata={"meaning": text}) for name, kind, text in (*columns, *AFTER)])


class Block(NamedTuple):
    """Cases of one recording and one set of parameter files, which a worker computes together."""

    output: str
    """Absolute path or address of the folder of results"""
    note: str
    """Name of a file in that folder, by which a worker sees that it is the same one"""
    run: str
    """Random name of the run of the client"""
    series: bool
    """Whether all answers of every case are kept, too"""
    number: int
    """Number of cases of the whole study"""
    model: str
    """Digest of the client's model, see `what_answers`"""
    bag: str
    """The bag as the study names it"""
    params: tuple[str, ...]
    """The parameter files as the study names them"""
    place: str
    """Absolute path or address of the bag"""
    digest: str
    """SHA-256 of the bag's content"""
    values: str
    """All parameters that the cases have in common, as JSON"""
    files: tuple[tuple[str, str], ...]
    """Names and contents of the files that parameters name"""
    names: tuple[str, ...]
    """Names of the parameters that are varied"""
    rows: tuple[tuple[Any, ...], ...]
    """Values of these parameters, a row for each case"""
    keys: tuple[str, ...]
    """Keys of the cases, see `case_key`"""
    there: tuple[bool, ...]
    """Whether a case has its row already, and lacks its answers alone"""


def compute_block(block: Block) -> tuple[int, tuple[str, ...]]:
    """Compute a block and write it; the worker reads nothing but the bag.

    Returns:
        The number of cases that have no outcome, and sentences on parts of the bag that cannot be read.

    Raises:
        UsageError: bag or folder cannot be used, or this is another version of the model.
        IncompleteError: the disk is full.
    """
    worker, shards = f"worker {get_worker().address}", Shards(block.output, block.run)
    if block.model != what_answers():
        raise UsageError(f"{worker}: another version of knee_contact_ros than here; install the same")
    if not shards.has(block.note):
        raise UsageError(f"output {block.output}: {worker} does not see this folder; one that all share")
    knees = _knees(block.place, block.digest, block.values, block.files)
    cases = [dict(zip(block.names, row, strict=True)) for row in block.rows]
    compiled = worth_compiling(block.number * len(knees.recording.steps))
    computed = compute(knees, cases, series=block.series, compiled=compiled)
    table, series = _table(block, knees, cases, computed), _series(block.keys, computed) if block.series else None
    with shards.errors():
        shards.write(table.filter([not there for there in block.there]), series)
    _freeze()
    return sum(map(bool, computed.failed)), knees.recording.damage


@lru_cache(4)
def _knees(place: str, digest: str, values: str, files: tuple[tuple[str, str], ...]) -> Knees:
    with here(place, place) as (path, found):
        if found != digest:
            raise UsageError(f"bag {place}: worker {get_worker().address} finds another content than the client")
        parameters, known = load_parameters(json.loads(values)), dict(files)
        recording, _ = read_recording(path, parameters, file_texts(parameters, known))
        return Knees(recording, parameters, known)


@cache
def _freeze() -> None:
    """Exempt all that is loaded from garbage collection, once the first block is done.

    Thousands of cases start many collections, and each takes a quarter of a second for the compiler's objects.
    """
    gc.freeze()


def _table(block: Block, knees: Knees, cases: Sequence[Mapping[str, Any]], computed: Computed) -> pa.Table:
    """Make the rows of a block's cases."""
    number, varied = len(cases), set(block.names)
    columns: dict[str, Any] = {
        "case": list(block.keys), "bag": [block.bag] * number, "params": [" + ".join(block.params)] * number,
        "failed": computed.failed, "seconds": [computed.seconds] * number,
    }  # fmt: skip
    for name, common in all_values(knees.parameters).items():
        if {name, name.removeprefix(LATERAL_KNEE)} & varied:
            value_in = attrgetter(name)
            columns[name] = [value_in(one) if one else values.get(name, common)
                             for one, values in zip(computed.parameters, cases, strict=True)]  # fmt: skip
        elif may_vary(name):  # looked up once for all cases
            columns[name] = pa.repeat(pa.scalar(common, schema().field(name).type), number)
    for prefix, rows in zip(("", LATERAL), computed.outcomes, strict=True):
        columns |= {prefix + outcome.name: rows[outcome.name] for outcome in OUTCOMES}
    table = pa.table({name: columns[name] for name in schema().names}, schema=schema())
    return table.replace_schema_metadata({"PANDAS_ATTRS": json.dumps({"varied": sorted(varied)})})


def _series(keys: Sequence[str], computed: Computed) -> pa.Table:
    """Make the table of all answers of the cases: key, compartment, stamp [ns], and the fields of the message."""
    parts = []
    for place, (side, answers) in enumerate(zip(("medial", "lateral"), computed.series, strict=False)):
        known = computed.has(place)
        rows = answers[known].ravel().view(FLAT)
        cases, compartments = np.repeat(np.array(keys)[known], answers.shape[1]), np.repeat([side], len(rows))
        columns = {name: np.ascontiguousarray(rows[name]) for name in ("stamp", *TOLD)}
        parts.append(pa.table({"case": cases, "compartment": compartments, **columns}))
    return pa.concat_tables(parts)


def note_of(study: Study) -> tuple[str, str]:
    """Give the name and the text of the note: a copy of the study's content in the folder of its results."""
    text = json.dumps(study.content, indent=1, default=str)
    return f"{STUDY}{hashlib.sha256(text.encode()).hexdigest()[:16]}.json", text


class Shards:
    """Reads and writes the shards in the folder of a study's results."""

    def __init__(self, url: str, run: str = "") -> None:
        """Take a folder, which need not exist yet; `run` is in the names of unfinished files.

        Raises:
            UsageError: the address cannot be used.
        """
        self.url, self.run = url, run
        with self.errors():
            self.files, self.folder = fsspec.core.url_to_fs(url, use_listings_cache=False)

    def make(self, note: str, text: str) -> None:
        """Make the folder, if it does not exist, and write the note (`note_of`) into it.

        Raises:
            UsageError: the folder cannot be made or written.
            IncompleteError: the disk is full.
        """
        with self.errors():
            self.files.makedirs(self.folder, exist_ok=True)
            self.put(note, text.encode())

    def has(self, name: str) -> bool:
        """Whether the folder has a file."""
        return bool(self.files.exists(f"{self.folder}/{name}".rstrip("/")))

    @contextmanager
    def errors(self) -> Iterator[None]:
        """Let errors that come with reading or writing the folder name it, in a line."""
        try:
            yield
        except ToldError:
            raise
        except Exception as error:  # a boundary: each kind of store has errors of its own
            full = isinstance(error, OSError) and error.errno in FULL
            raise (IncompleteError if full else UsageError)(f"output {self.url}: {reason(error)}") from None

    def finished(self, folder: str = "") -> set[str]:
        """Give the keys of all finished cases; with the folder `SERIES`, of those whose answers are kept.

        Raises:
            UsageError: the folder holds something else, or a shard is damaged.
        """
        tables = (self._read(f"{folder}/{name}".lstrip("/"), ["case"]) for name in self.names(folder))
        return {key for table in tables for key in table["case"].unique().to_pylist()}

    def rows(self, keys: Sequence[str], columns: Sequence[str]) -> pd.DataFrame:
        """Read columns of the cases with these keys, in the order of the keys.

        Raises:
            UsageError: the folder holds something else.
            IncompleteError: a case is missing.
        """
        parts = [self._read(name, ["case", *columns]).to_pandas() for name in self.names()]
        found = pd.concat(parts).drop_duplicates("case").set_index("case")
        missing = (~pd.Index(keys).isin(found.index)).sum()
        if missing:
            raise IncompleteError(f"output {self.url}: {missing} of {len(keys)} cases are not there")
        return found.loc[list(keys)]

    def names(self, folder: str = "") -> list[str]:
        """Names of the shards in the folder of results, or in a folder inside it.

        Raises:
            UsageError: the folder holds something else.
        """
        place = f"{self.folder}/{folder}".rstrip("/")
        with self.errors():
            if not self.files.exists(place):
                return []
            if not self.files.isdir(place):
                raise UsageError(f"output {self.url}: it is no folder")
            entries = [PurePosixPath(name.rstrip("/")).name for name in self.files.ls(place, detail=False)]
        names = sorted(name for name in entries if not name.startswith(("_", ".")))
        for name in names:
            if not (name.startswith("cases-") and name.endswith(".parquet")):
                raise UsageError(f"output {self.url}: holds {name}, which is none of a study's results")
        return names

    def _read(self, name: str, columns: Sequence[str] | None = None) -> pa.Table:
        """Read a shard from its bytes: Arrow's threads would release a Python file after Python's end, and abort.

        Raises:
            UsageError: it is damaged, or no shard.
        """
        try:
            content = self.files.cat_file(f"{self.folder}/{name}")
            return pq.read_table(pa.BufferReader(content), columns=list(columns) if columns else None)
        except Exception as error:  # a boundary: damaged files raise what they like
            why = reason(error).splitlines()[0]
            raise UsageError(
                f"output {self.url}: {name} is damaged, or none of a study's results ({why}): move it away, and its "
                "cases are computed again"
            ) from None

    def write(self, table: pa.Table, series: pa.Table | None) -> None:
        """Write a shard of the table, after one with all answers if there is a `series`; of an empty one none.

        Raises:
            OSError: they cannot be written; a shard that could not be completed does not appear.
        """
        for folder, one in ((SERIES, series), ("", table)):
            if one is not None and len(one):
                self.files.makedirs(f"{self.folder}/{folder}".rstrip("/"), exist_ok=True)
                content = pa.BufferOutputStream()
                pq.write_table(one, content, compression="zstd")
                name = f"cases-{_digest(' '.join(one['case'].unique().to_pylist()))}.parquet"
                self.put(f"{folder}/{name}".lstrip("/"), memoryview(content.getvalue()))

    def put(self, name: str, content: bytes | memoryview) -> None:
        """Write a file that gets its name when it is complete, and on the disk.

        Raises:
            OSError: it cannot be written.
        """
        unfinished = f"{self.folder}/{PurePosixPath(name).with_name(f'{UNFINISHED}{self.run}-{uuid.uuid4().hex}')}"
        try:
            with self.files.open(unfinished, "wb") as file:
                file.write(content)
                if isinstance(self.files, LocalFileSystem):
                    file.flush()
                    os.fsync(file.fileno())
            self.files.mv(unfinished, f"{self.folder}/{name}")
        except BaseException:
            with suppress(Exception):
                self.files.rm(unfinished)
            raise

    def sweep_up(self) -> None:
        """Remove the unfinished files of this run, and those that another has left long ago."""
        with suppress(Exception):
            for path, entry in self.files.find(self.folder, maxdepth=2, detail=True).items():
                name, written = PurePosixPath(path).name, float(entry.get("mtime") or time.time())
                old = name.startswith(UNFINISHED) and time.time() - written > LONG_AGO
                if old or name.startswith(f"{UNFINISHED}{self.run}-"):
                    self.files.rm(path)


class Plan:
    """The cases of a study as the client knows them: by their keys. Their parameters are left to the workers."""

    def __init__(self, study: Study) -> None:
        """Read and check the bags and parameter files of a study.

        Raises:
            UsageError: a bag, a parameter file or a file that one names cannot be used.
        """
        self.study = study
        self.there = 0
        """Number of cases so far that were finished already, or are the same as another case"""
        self._bags = {bag: _bag(bag) for bag in study.bags}
        self._parameters = {
            (bag, params): with_weight([*params, study.values], self._bags[bag].weight)
            for bag in study.bags
            for params in study.params
        }
        self._varied = {place: variations_of(one) for place, one in self._parameters.items()}
        self._files: dict[str, str] = {}
        for one in self._parameters.values():
            file_texts(one, self._files)
        for name, values in study.grid.items():
            self._files |= {file: read_curve(name, file) for file in values if name.endswith(NAME_FILES)}

    def key(self, case: Case) -> str:
        """Give the key of a case, also of one whose parameters are not allowed."""
        digest, place = self._bags[case.bag].digest, (case.bag, case.params)
        try:
            parameters = self._varied[place](case.values)
            return case_key(digest, parameters, file_texts(parameters, self._files))
        except UsageError:
            common = case_key(digest, self._parameters[place], {})
            return _digest(f"{common} {sorted(case.values.items())!r}")

    def blocks(self, shards: Shards) -> Iterator[Block]:
        """Give the missing cases in blocks; a block is made when it is wanted."""
        study, note, rows = self.study, note_of(self.study)[0], shards.finished()
        known = rows & shards.finished(SERIES) if study.series else set(rows)

        def missing(numbers: range) -> Iterator[tuple[str, tuple[Any, ...], bool]]:
            for case in map(study.case, numbers):
                key = self.key(case)
                if key in known:
                    self.there += 1
                else:
                    known.add(key)
                    yield key, tuple(case.values.values()), key in rows

        for first in range(0, study.number, study.variants):
            bag, params, _ = study.case(first)
            place, digest, ticks, _ = self._bags[bag]
            size = max(1, min(max(-(-study.variants // PARTS), LEAST), TICKS_A_BLOCK // ticks))
            left = missing(range(first, first + study.variants))
            while cases := list(itertools.islice(left, size)):
                keys, values, there = zip(*cases, strict=True)
                yield Block(
                    shards.url, note, shards.run, study.series, study.number, what_answers(), bag, params, place,
                    digest, json.dumps(all_values(self._parameters[bag, params])), tuple(sorted(self._files.items())),
                    tuple(study.names), values, keys, there,
                )  # fmt: skip


class Bag(NamedTuple):
    """A bag of a study."""

    place: str
    digest: str
    ticks: int
    """Approximate number of ticks"""
    weight: float | None
    """Body weight [N] that it was imported with"""


def _bag(name: str) -> Bag:
    place = absolute(name)
    with here(place, name) as (path, digest):
        files = [file for file in path.rglob("*") if file.is_file()] if path.is_dir() else [path]
        ticks = max(1, sum(file.stat().st_size for file in files) // BYTES_A_TICK)
        return Bag(place, digest, ticks, weight_of(path))


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
        opened.enter_context(config.set(DASK))
        for name in [name for name in logging.root.manager.loggerDict if name.startswith(LOGS)]:
            logging.getLogger(name).setLevel(logging.CRITICAL)
        if scheduler:
            try:
                client = opened.enter_context(Client(scheduler, timeout=PATIENCE, set_as_default=False))
            except Exception as error:  # a boundary: an address may be of a kind that needs another library
                raise UsageError(f"scheduler {scheduler}: cannot be reached: {reason(error)}") from None
            if not client.nthreads():
                warn([f"scheduler {scheduler}: it has no workers yet, and is waited for"])
            yield client
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


def computed_by(client: Client, blocks: Iterator[Block]) -> Iterator[tuple[int, int, tuple[str, ...]]]:
    """Have blocks computed by the workers; yield number, failed cases and damage of each block as it is done.

    Raises:
        UsageError: a worker cannot use bag or folder.
        IncompleteError: the disk is full, workers died again and again, or the scheduler is gone.
    """
    running, of_future = as_completed(loop=client.loop), dict[str, Block]()
    future: Any = None

    def submit() -> None:
        wanted = max(LEAST_WAITING, WAITING * sum(client.nthreads().values())) - len(of_future)
        for block in itertools.islice(blocks, max(0, wanted)):
            submitted = client.submit(compute_block, block, pure=False, retries=0)
            of_future[submitted.key] = block
            running.add(submitted)

    try:
        submit()
        for future in running:
            block = of_future.pop(future.key)
            failed, damage = future.result()
            future.release()
            yield len(block.keys), failed, damage
            submit()
    except ToldError:
        raise
    except KilledWorker:
        where = f"{len(block.keys)} cases of bag {block.bag}"
        raise IncompleteError(f"workers died again and again at {where}: of too little memory? {REST}") from None
    except Exception as error:  # a boundary: whatever a worker may lack or meet; or the scheduler is gone
        if future is None or future.status != "error":
            raise IncompleteError(f"the scheduler is gone; {REST}") from None
        failure = f"{type(error).__name__}: {reason(error)}"
        raise IncompleteError(f"bag {block.bag}: a worker failed: {failure}; {REST}") from None


class Done(NamedTuple):
    """How many cases of a study were computed, and how many were not."""

    there: int
    """Cases that had been computed before, or that are the same as another case"""
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
    shards, plan = Shards(absolute(output), uuid.uuid4().hex[:12]), Plan(study)
    blocks, count, failed, damage = plan.blocks(shards), 0, 0, dict[str, None]()
    first = next(blocks, None)
    try:
        if first:
            with workers_of(workers, scheduler) as client:
                shards.make(*note_of(study))
                for number, without, damaged in computed_by(client, itertools.chain([first], blocks)):
                    count, failed = count + number, failed + without
                    damage |= dict.fromkeys(damaged)
                    advance(plan.there + count, study.number)
    finally:
        shards.sweep_up()
    return Done(study.number - count, count, failed, tuple(damage))


def run_sweep(study: Path, output: str, workers: int, scheduler: str) -> None:
    """Do the work of `knee-contact sweep`: compute the missing cases of a study file, and report in a few lines.

    Args:
        study: Study file (YAML).
        output: Folder of the results, local or as fsspec spells it.
        workers: Processes on this machine; 0: one for each processor.
        scheduler: Address of a Dask scheduler whose workers compute instead; empty for this machine.

    Raises:
        UsageError: see `run_study`.
        IncompleteError: see `run_study`.
    """
    cases = read_study(study)
    with progress("Computing") as advance:
        done = run_study(cases, output, workers=workers, scheduler=scheduler, advance=advance)
    warn(f"damaged, and computed as far as it can be read: {sentence}" for sentence in done.damage)
    say(f"{cases.number} cases: {done.computed} computed, {done.there} were there, {done.failed} failed")
    say(f"table: {output} (pandas.read_parquet)")
