"""A study on Dask: blocks of cases are computed by workers, each of which writes its table into the folder."""

from __future__ import annotations

import errno
import fcntl
import gc
import hashlib
import itertools
import json
import logging
import os
import random
import signal
import time
import uuid
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import CancelledError
from contextlib import ExitStack, contextmanager, suppress
from functools import cache, lru_cache
from multiprocessing import resource_tracker
from operator import attrgetter
from pathlib import Path, PurePosixPath
from tempfile import TemporaryDirectory
from typing import Any, NamedTuple, TypeVar

import fsspec
import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq
from dask import config
from distributed import Client, LocalCluster, as_completed
from distributed.comm import CommClosedError
from distributed.scheduler import KilledWorker
from fsspec.implementations.local import LocalFileSystem

from knee_contact_ros.bags.provenance import bag_digest, model_digest
from knee_contact_ros.lab.study import Group, Study, read_study
from knee_contact_ros.lab.sweep import (
    LATERAL,
    OUTCOMES,
    Computed,
    Files,
    Knees,
    Values,
    compute,
    knees_in,
    may_vary,
    outcomes_of,
)
from knee_contact_ros.model.types import FLAT, TOLD
from knee_contact_ros.parameters.files import (
    all_values,
    curve_files,
    known_parameters,
    load_parameters,
    read_curve,
    variations_of,
)
from knee_contact_ros.parameters.schema import LATERAL as LATERAL_KNEE
from knee_contact_ros.parameters.schema import Parameters, has_both
from knee_contact_ros.system.errors import IncompleteError, ToldError, UsageError
from knee_contact_ros.system.files import expanded
from knee_contact_ros.system.terminal import progress, say, warn


def is_elsewhere(name: str) -> bool:
    """Whether a name is an address for fsspec, and not a path on this machine."""
    return "://" in name or "::" in name


def absolute(name: str) -> str:
    """Make a path absolute, so that it means the same in every process; an address stays as it is.

    Raises:
        UsageError: the name is empty, or has a zero byte.
    """
    if not name or "\0" in name:
        raise UsageError(f"{name!r} is not allowed; a path, or an address as s3://bucket/folder")
    return name if is_elsewhere(name) else str(expanded(name).absolute())


@contextmanager
def here(bag: str) -> Iterator[Path]:
    """Give the path of a bag on this machine; a bag behind an address is copied for the time of the context.

    Raises:
        UsageError: the bag cannot be fetched.
    """
    if not is_elsewhere(bag):
        yield Path(bag)
        return
    with TemporaryDirectory(prefix="knee_contact_bag_") as folder:
        try:
            files, path = fsspec.core.url_to_fs(bag)
            copy = Path(folder) / (PurePosixPath(str(path)).name or "bag")
            files.get(path, str(copy), recursive=bool(files.isdir(path)))
        except Exception as error:  # a boundary: each kind of store has errors of its own
            raise UsageError(f"bag {bag}: cannot be fetched: {reason(error)}") from None
        yield copy


def digest_of(bag: str, path: Path) -> str:
    """Give the SHA-256 of the content of a bag.

    Args:
        bag: Name of the bag, for error messages.
        path: Where the bag, or a copy of it, lies on this machine.

    Raises:
        UsageError: the bag cannot be read.
    """
    try:
        return bag_digest(path)
    except OSError as error:
        raise UsageError(f"bag {bag}: {reason(error)}") from None


def reason(error: BaseException) -> str:
    """Describe an error in few words."""
    return getattr(error, "strerror", None) or str(error) or type(error).__name__


DIGITS = 32
"""Number of hexadecimal digits of a key"""
NOT_COUNTED = {"autostart", "deadline", "diagnostics", "record", "rerun"}
"""Sections of the parameters that change no answer, and so no key"""
MEANING = 1
"""Version of the outcomes' definitions: to be increased when a column is computed in another way"""


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
    left_out = NOT_COUNTED if has_both(parameters) else NOT_COUNTED | {"lateral"}
    if texts:
        parameters = _renamed(parameters, {name: _digest_of_text(texts[name]) for name in curve_files(parameters)})
    return _digest(f"{what_answers()} {bag} {parameters.model_dump_json(exclude=left_out)}")


def refused_key(bag: str, common: Parameters, values: Mapping[str, Any]) -> str:
    """Make the key of a case whose parameters are not allowed, from the common parameters and its own values."""
    return _digest(f"{what_answers()} {bag} {common.model_dump_json(exclude=NOT_COUNTED)} {sorted(values.items())!r}")


def _renamed(parameters: Parameters, names: Mapping[str, str]) -> Parameters:
    """Give parameters with other names of files."""

    def with_value(section: Any, path: Sequence[str], value: str) -> Any:
        first, *rest = path
        inner = with_value(getattr(section, first), rest, value) if rest else value
        return section.model_copy(update={first: inner})

    for name, value in names.items():
        parameters = with_value(parameters, name.split("."), value)
    return parameters


@lru_cache(64)
def _digest_of_text(text: str) -> str:
    return hashlib.sha256(text.encode()).hexdigest()


def _digest(content: str) -> str:
    return hashlib.sha256(content.encode()).hexdigest()[:DIGITS]


def shard_name(keys: Sequence[str]) -> str:
    """Make the name of the file that holds the cases of some keys."""
    return f"cases-{_digest(' '.join(keys))}.parquet"


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


@lru_cache
def schema() -> pa.Schema:
    """Give the names and types of the columns; their meanings are in the fields' metadata."""
    fields = [_field(*column) for column in BEFORE]
    for name, declared in known_parameters().items():
        if may_vary(name):
            fields.append(_field(name, TYPES[type(declared.default)], declared.description))
    for prefix, compartment in (("", ""), (LATERAL, " of the lateral compartment")):
        for outcome in OUTCOMES:
            unit = f"[{outcome.unit}] " if outcome.unit else ""
            fields.append(_field(prefix + outcome.name, pa.float64(), f"{unit}{outcome.meaning}{compartment}"))
    return pa.schema([*fields, *(_field(*column) for column in AFTER)])


def _field(name: str, kind: pa.DataType, meaning: str) -> pa.Field:
    return pa.field(name, kind, metadata={"meaning": meaning})


def table_of(
    keys: Sequence[str], bag: str, params: Sequence[str], knees: Knees, cases: Sequence[Values],
    computed: Sequence[Computed],
) -> pa.Table:  # fmt: skip
    """Make the table of cases of one recording and one set of parameter files.

    Args:
        keys: Keys of the cases.
        bag: The recording, as the study names it.
        params: The parameter files, as the study names them.
        knees: What the cases have in common.
        cases: Values of the varied parameters of each case.
        computed: Results of the cases.
    """
    number = len(cases)
    columns: dict[str, Any] = {"case": list(keys), "bag": [bag] * number, "params": [" + ".join(params)] * number}
    columns |= _values_of(knees, cases, computed)
    for side, prefix in enumerate(("", LATERAL)):
        rows = outcomes_of(computed, side)
        columns |= {prefix + outcome.name: rows[outcome.name] for outcome in OUTCOMES}
    columns["failed"] = [one.failed for one in computed]
    columns["seconds"] = [one.seconds for one in computed]
    return pa.table({name: columns[name] for name in schema().names}, schema=schema())


def _values_of(knees: Knees, cases: Sequence[Values], computed: Sequence[Computed]) -> dict[str, Any]:
    """Make the columns of the parameters that a study may vary; what all cases have in common is looked up once."""
    columns: dict[str, Any] = {}
    varied = {name for values in cases for name in values}
    for name, common in all_values(knees.parameters).items():
        if {name, name.removeprefix(LATERAL_KNEE)} & varied:
            value_in = attrgetter(name)
            columns[name] = [value_in(one.parameters) if one.parameters else values.get(name, common)
                             for one, values in zip(computed, cases, strict=True)]  # fmt: skip
        elif may_vary(name):
            columns[name] = pa.repeat(pa.scalar(common, schema().field(name).type), len(cases))
    return columns


def series_of(keys: Sequence[str], computed: Sequence[Computed]) -> pa.Table:
    """Make the table of all answers of the cases: key, compartment, stamp [ns], and the fields of the message."""
    parts = [
        (key, side, rows)
        for key, one in zip(keys, computed, strict=True)
        for side, rows in zip(("medial", "lateral"), one.series, strict=False)
    ]
    names = ("stamp", *TOLD)
    rows = np.concatenate([rows for *_, rows in parts]).view(FLAT) if parts else np.zeros(0, FLAT)
    lengths = [len(rows) for *_, rows in parts]
    columns: dict[str, Any] = {
        "case": pa.array(np.repeat([key for key, *_ in parts], lengths).tolist(), pa.string()),
        "compartment": pa.array(np.repeat([side for _, side, _ in parts], lengths).tolist(), pa.string()),
    }
    return pa.table(columns | {name: np.ascontiguousarray(rows[name]) for name in names})


SERIES = "_series"
UNFINISHED = "_unfinished-"
STUDY = "_study-"
LOCK = "_lock"
RUN = b"knee_contact_run"
"""Key in the metadata of a shard for the name of the run that has written it"""
FULL = {errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EIO}
"""Errors that are no fault of the user's"""


def note_of(content: Mapping[str, Any]) -> tuple[str, str]:
    """Give the name and the text of the note: a copy of the study's content in the folder of its results."""
    text = json.dumps(content, indent=1, default=str)
    return f"{STUDY}{hashlib.sha256(text.encode()).hexdigest()[:16]}.json", text


class Shards:
    """Reads and writes the shards in the folder of a study's results."""

    def __init__(self, url: str, run: str = "") -> None:
        """Take a folder, which need not exist yet.

        Args:
            url: Path or address of the folder.
            run: Name of this run, which is in the names of its unfinished files and in the metadata of its shards.

        Raises:
            UsageError: the address cannot be used.
        """
        try:
            self._files, self._folder = fsspec.core.url_to_fs(url, use_listings_cache=False)
        except Exception as error:  # a boundary: each kind of store has errors of its own
            raise UsageError(f"output {url}: {reason(error)}") from None
        self.url, self._run = url, run

    def make(self, note: str, text: str) -> None:
        """Make the folder, if it does not exist, and write the note (`note_of`) into it.

        Raises:
            UsageError: the folder cannot be made or written.
            IncompleteError: the disk is full.
        """
        new = not self._files.exists(self._folder)
        try:
            self._files.makedirs(self._folder, exist_ok=True)
            with self._appearing("", note) as file:
                file.write(text.encode())
        except Exception as error:  # a boundary, likewise
            with suppress(Exception):
                if new:
                    self._files.rmdir(self._folder)
            raise self.error_of(error) from None

    def error_of(self, error: BaseException) -> ToldError:
        """Give the error to raise for one that came with reading or writing the folder."""
        full = isinstance(error, OSError) and error.errno in FULL
        return (IncompleteError if full else UsageError)(f"output {self.url}: {reason(error)}")

    def finished(self, *, series: bool) -> set[str]:
        """Give the keys of all finished cases; with `series`, only of those whose answers are kept, too.

        Raises:
            UsageError: the folder holds something else, or a shard is damaged.
        """
        try:
            names = self.names()
            whole = self.names(SERIES) if series else names
        except ToldError:
            raise
        except Exception as error:  # a boundary, likewise
            raise self.error_of(error) from None
        return {key for name in names if name in whole for key in self._keys(name)}

    def rows(self, keys: Sequence[str], columns: Sequence[str]) -> pa.Table:
        """Read columns of the cases with these keys, in the order of the keys.

        Raises:
            UsageError: the folder holds something else.
            IncompleteError: a case is missing.
        """
        parts = [self._read(name, ["case", *columns]) for name in self.names()]
        table = (
            pa.concat_tables([part for part in parts if part]) if any(parts) else pa.table({"case": pa.array([], "")})
        )
        places = pc.index_in(pa.array(keys, pa.string()), table["case"].combine_chunks())
        if places.null_count:
            raise IncompleteError(f"output {self.url}: {places.null_count} of {len(keys)} cases are not there")
        return table.take(places)

    def names(self, folder: str = "") -> list[str]:
        """Names of the shards in the folder of results, or in a folder inside it.

        Raises:
            UsageError: the folder holds something else.
        """
        place = f"{self._folder}/{folder}".rstrip("/")
        if not self._files.exists(place):
            return []
        if not self._files.isdir(place):
            raise UsageError(f"output {self.url}: it is no folder")
        entries = (PurePosixPath(name.rstrip("/")).name for name in self._files.ls(place, detail=False))
        names = sorted(name for name in entries if not name.startswith(("_", ".")))
        for name in names:
            if not (name.startswith("cases-") and name.endswith(".parquet")):
                raise UsageError(f"output {self.url}: holds {name}, which is none of a study's results")
        return names

    def _keys(self, name: str) -> list[str]:
        """Keys of the cases in a shard."""
        table = self._read(name, ["case"])
        keys: list[str] = table["case"].to_pylist() if table else []
        return keys

    def _read(self, name: str, columns: Sequence[str]) -> pa.Table | None:
        """Read columns of a shard; None if another client has just removed it.

        Raises:
            UsageError: it is damaged, or no shard.
        """
        try:
            return self._whole(name, columns)
        except FileNotFoundError:
            return None
        except Exception as error:  # a boundary: damaged files raise what they like
            why = reason(error).splitlines()[0]
            raise UsageError(
                f"output {self.url}: {name} is damaged, or none of a study's results ({why}): move it away, and its "
                "cases are computed again"
            ) from None

    def _whole(self, name: str, columns: Sequence[str] | None = None) -> pa.Table:
        """Read a shard from its bytes: Arrow's threads would release a Python file after Python's end, and abort."""
        content = self._files.cat_file(f"{self._folder}/{name}")
        return pq.read_table(pa.BufferReader(content), columns=list(columns) if columns else None)

    def holds(self, name: str, *, series: bool) -> bool:
        """Whether a shard exists, and with `series` also the one with all answers."""
        folders = ("", f"{SERIES}/") if series else ("",)
        return all(self._files.exists(f"{self._folder}/{folder}{name}") for folder in folders)

    def has_note(self, note: str) -> bool:
        """Whether the folder has the note that `make` writes."""
        return bool(self._files.exists(f"{self._folder}/{note}"))

    def by_whom(self, name: str) -> tuple[bool, int]:
        """Give whether this run has written a shard, and how many of its cases failed."""
        table = self._whole(name, ["failed"])
        ours = (table.schema.metadata or {}).get(RUN) == self._run.encode()
        return ours, sum(map(bool, table["failed"].to_pylist()))

    def write(self, table: pa.Table, series: pa.Table | None) -> str:
        """Write a shard of the table, after one with all answers if there is a `series`; return the name of both.

        Raises:
            OSError: they cannot be written; a shard that could not be completed does not appear.
        """
        name = shard_name(table["case"].to_pylist())
        if series is not None:
            self._files.makedirs(f"{self._folder}/{SERIES}", exist_ok=True)
            with self._appearing(f"{SERIES}/", name) as file:
                pq.write_table(series, file, compression="zstd")
        table = table.replace_schema_metadata({RUN: self._run})
        with self._appearing("", name) as file:
            pq.write_table(table, file, compression="zstd")
        return name

    @contextmanager
    def _appearing(self, folder: str, name: str) -> Iterator[Any]:
        """Open a file that gets its name when it is complete, and on the disk."""
        unfinished = f"{self._folder}/{folder}{UNFINISHED}{self._run}-{uuid.uuid4().hex}"
        try:
            with self._files.open(unfinished, "wb") as file:
                yield file
                if isinstance(self._files, LocalFileSystem):
                    file.flush()
                    os.fsync(file.fileno())
            self._files.mv(unfinished, f"{self._folder}/{folder}{name}")
        except BaseException:
            with suppress(Exception):
                self._files.rm(unfinished)
            raise

    def unite(self) -> None:
        """Remove cases that are in several shards from all but one: clients that share the folder write such ones."""
        with self._locked() as locked:
            places: dict[str, str] = {}
            whole = set(self.names(SERIES))
            for name in sorted(self.names(), key=lambda name: (name not in whole, name)) if locked else []:
                keys = self._keys(name)
                own = [key for key in keys if places.get(key, name) == name]
                kept = name if len(own) == len(keys) else self._keep(name, own, series=name in whole)
                places |= dict.fromkeys(own, kept)

    def _keep(self, name: str, keys: list[str], *, series: bool) -> str:
        """Replace a shard by one with some of its cases, and return the new name."""
        table, answers = self._only("", name, keys), self._only(f"{SERIES}/", name, keys) if series else None
        kept = self.write(table, answers) if keys else ""
        self._files.rm(f"{self._folder}/{name}")
        if series:
            self._files.rm(f"{self._folder}/{SERIES}/{name}")
        return kept

    def _only(self, folder: str, name: str, keys: list[str]) -> pa.Table:
        table = self._whole(f"{folder}{name}")
        return table.filter(pc.is_in(table["case"], value_set=pa.array(keys, pa.string())))

    @contextmanager
    def _locked(self) -> Iterator[bool]:
        """Keep other clients from uniting the folder for the time of the context; False if it cannot be locked."""
        if not isinstance(self._files, LocalFileSystem):
            yield False
            return
        with ExitStack() as opened:
            try:
                file = opened.enter_context(Path(self._folder, LOCK).open("w"))
                fcntl.flock(file, fcntl.LOCK_EX)
            except OSError:  # read only, or a file system without locks
                yield False
                return
            yield True

    def sweep_up(self, age: float) -> None:
        """Remove the unfinished files of this run, and those of other runs that are older than an `age` [s]."""
        for folder in (self._folder, f"{self._folder}/{SERIES}"):
            with suppress(Exception):
                for entry in self._files.ls(folder, detail=True) if self._files.exists(folder) else []:
                    name = PurePosixPath(entry["name"]).name
                    old = time.time() - float(entry.get("mtime") or time.time()) > age
                    if name.startswith(f"{UNFINISHED}{self._run}-") or (name.startswith(UNFINISHED) and old):
                        self._files.rm(entry["name"])


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


TICKS_A_BLOCK = 800_000
"""Ticks of a block: more than a tenth of a second of a worker's time, ten times the overhead of a block"""
LEAST, PARTS = 8, 16
"""The least number of cases in a block, and the number of blocks into which a small study is divided"""
BLOCKS_A_STRETCH = 4
"""Number of blocks whose keys are made before the first of them is sent to a worker"""
NAME_FILES = (".profile", ".table", ".share_file")
"""Endings of the names of those parameters whose values are names of files"""
BYTES_A_TICK = 100
"""The most bytes that a tick takes in a compressed bag"""
Item = TypeVar("Item")


class Bag(NamedTuple):
    """A recording that a study uses."""

    place: str
    """Absolute path or address"""
    digest: str
    """SHA-256 of its content"""
    ticks: int
    """Approximate number of ticks, estimated from the size of the files"""


class Knee(NamedTuple):
    """A recording and one set of parameter files, with the cases that share them."""

    group: Group
    bag: Bag
    parameters: Parameters
    """Parameters before any value is varied"""


def knees_of(study: Study) -> list[Knee]:
    """Read and check the bags and parameter files of a study, and give every combination of them.

    Raises:
        UsageError: a bag, a parameter file or a file that one names cannot be used.
    """
    bags = {bag: _bag(bag) for bag in study.bags}
    parameters = {params: load_parameters([*params, study.values]) for params in study.params}
    for one in parameters.values():
        Files().texts(one)
    for name, values in study.grid.items():
        for file in values if name.endswith(NAME_FILES) else []:
            read_curve(name, file)
    return [Knee(group, bags[group.bag], parameters[group.params]) for group in study.groups()]


def _bag(name: str) -> Bag:
    place = absolute(name)
    with here(place) as path:
        digest = digest_of(name, path)
        files = [file for file in path.rglob("*") if file.is_file()] if path.is_dir() else [path]
        size = sum(file.stat().st_size for file in files)
        return Bag(place, digest, max(1, size // BYTES_A_TICK))


def keys_of(study: Study) -> list[str]:
    """Keys of all cases of a study, in the order of the cases' numbers.

    Raises:
        UsageError: see `knees_of`.
    """
    files = Files()
    return [case.key for knee in knees_of(study) for case in _keyed(study, knee, knee.group.numbers, files)]


class Keyed(NamedTuple):
    """A case as the client knows it, which leaves its parameters to the workers."""

    number: int
    """The case's number in the study"""
    key: str
    """Digest of the case, see `case_key`"""
    files: tuple[str, ...]
    """Names of the files that the case's parameters name"""


def _keyed(study: Study, knee: Knee, numbers: range, files: Files) -> Iterator[Keyed]:
    """Give cases by their numbers, also those whose parameters are not allowed."""
    varied = variations_of(knee.parameters)
    for number in numbers:
        values = study.values_of(number)
        named: tuple[str, ...] = ()
        try:
            parameters = varied(values)
            key = case_key(knee.bag.digest, parameters, files.texts(parameters))
            named = tuple(curve_files(parameters).values())
        except UsageError:
            key = refused_key(knee.bag.digest, knee.parameters, values)
        yield Keyed(number, key, named)


class Missing:
    """Iterates over the blocks of the missing cases of a study; a block is made when it is wanted."""

    def __init__(self, study: Study, knees: list[Knee], finished: set[str], target: Target) -> None:
        """Take a study with its knees, the keys of the cases that are finished, and where the results go."""
        self._study, self._knees, self._known, self._target = study, knees, finished, target
        self._files = Files()
        self.there = 0
        """Number of cases so far that were finished already, or are the same as another case"""

    def __iter__(self) -> Iterator[Block]:
        stretches = [
            (knee, numbers)
            for knee in self._knees
            for numbers in _sliced(knee.group.numbers, BLOCKS_A_STRETCH * _size_of_block(knee))
        ]
        for knee, numbers in _from_anywhere(stretches):
            blocks = _sliced(self._missing(knee, numbers), _size_of_block(knee))
            yield from (self._block(knee, cases) for cases in _from_anywhere(blocks))

    def _missing(self, knee: Knee, numbers: range) -> list[Keyed]:
        """Give the cases that are not finished, and count the others."""
        missing = []
        for case in _keyed(self._study, knee, numbers, self._files):
            if case.key in self._known:
                self.there += 1
            else:
                self._known.add(case.key)
                missing.append(case)
        return missing

    def _block(self, knee: Knee, cases: Sequence[Keyed]) -> Block:
        keys = tuple(case.key for case in cases)
        self._files.texts(knee.parameters)
        named = set(curve_files(knee.parameters).values()).union(*(case.files for case in cases))
        files = tuple((name, self._files.known[name]) for name in sorted(named))
        values = json.dumps(all_values(knee.parameters))
        rows = tuple(self._study.row(case.number) for case in cases)
        return Block(
            self._target, Source(knee.bag.place, knee.bag.digest, values, files), knee.group.bag, knee.group.params,
            tuple(self._study.names), rows, keys, shard_name(keys),
        )  # fmt: skip


def _size_of_block(knee: Knee) -> int:
    shared = -(-len(knee.group.numbers) // PARTS)
    return max(1, min(max(shared, LEAST), TICKS_A_BLOCK // knee.bag.ticks))


def _sliced(items: Any, size: int) -> list[Any]:
    """Cut a list or a range into parts of a size; the last one may be smaller."""
    return [items[begin : begin + size] for begin in range(0, len(items), size)]


def _from_anywhere(items: list[Item]) -> list[Item]:
    """Give all items in their order, from a random one on and then from the first."""
    begin = random.randrange(len(items)) if items else 0  # noqa: S311
    return [*items[begin:], *items[:begin]]


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


def run_sweep(study: Path, output: str, workers: int, scheduler: str) -> None:
    """Compute the missing cases of a study file, and print how many were computed and failed.

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
