"""The cases of a study: their keys, and the blocks of cases that workers compute.

A row of the table has a column for every parameter that a study may vary: it describes its knee completely, and tables
of several studies can be joined.
"""

from __future__ import annotations

import gc
import hashlib
import itertools
from collections.abc import Callable, Container, Iterator, Sequence
from contextlib import contextmanager
from functools import lru_cache
from pathlib import Path, PurePosixPath
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from .. import __version__
from ..bags.bag import Bag
from ..bags.folder import bag_digest
from ..bags.provenance import NOT_OF_THE_RESULT, model_digest
from ..model.types import FLAT, MESSAGE_FIELDS
from ..offline.bag_parameters import with_body_weight
from ..parameters.files import all_values, variations_of
from ..parameters.schema import LATERAL_PREFIX, Parameters, has_two_compartments
from ..system.errors import UsageError, join_faults
from ..system.files import expand_user
from .knees import (
    VARIABLE_PREFIXES,
    Computed,
    Knees,
    compute,
    file_texts,
    idle_doubt,
)
from .outcomes import LATERAL_OUTCOME, OUTCOME_RECORD, units_of
from .recordings import read_recording, recorded_doubt
from .shards import brief_reason, is_address
from .study_file import Study

if TYPE_CHECKING:
    import pandas as pd

CaseValues = dict[str, Any]
KEY_VERSION = 3
"""Version of the outcomes' definitions and of the keys: increase it when a column is computed differently"""
BLOCK_TICKS = 800_000
"""Ticks of a block. Tuned: more than 0.1 s of a worker's time, ten times the overhead of a block"""
MIN_BLOCK = 8
"""Least number of cases in a block, if a bag is not too long for it"""
BLOCKS_OF_A_STUDY = 16
"""Number of blocks into which a small study is divided, so that all workers have something to do"""
BYTES_A_TICK = 100
"""Largest size of a tick in a compressed bag [B]: a bag's size tells its ticks before it is read"""


@contextmanager
def local_bag(place: str) -> Iterator[tuple[Path, str]]:
    """Return the path of a bag on this machine and the SHA-256 of its content.

    A bag at an address is copied while the context lasts.

    Raises:
        UsageError: the bag cannot be fetched or read.
    """
    import fsspec

    with TemporaryDirectory(prefix="knee_contact_bag_") as folder:
        path = expand_user(place)
        try:
            if is_address(place):
                files, inner = fsspec.core.url_to_fs(place)
                path = Path(folder) / (PurePosixPath(str(inner)).name or "bag")
                files.get(inner, str(path), recursive=bool(files.isdir(inner)))
            digest = bag_digest(path)
        except Exception as error:  # a boundary: each kind of store has errors of its own
            cannot = "cannot be fetched: " if is_address(place) else ""
            raise UsageError(f"bag {place}: {cannot}{brief_reason(error)}") from None
        yield path, digest


@lru_cache
def answers_version() -> str:
    """Return a digest of the model's source and of the outcomes' definitions, which is part of every key."""
    return short_digest(repr((model_digest(), KEY_VERSION, OUTCOME_RECORD.names)))


@lru_cache(64)
def short_digest(content: str) -> str:
    """Return half of a text's SHA-256: 32 hexadecimal digits."""
    return hashlib.sha256(content.encode()).hexdigest()[:32]


class CaseGroup(NamedTuple):
    """Cases of a bag and a set of parameter files."""

    bag: str
    """The bag as the study names it"""
    place: str
    """Its absolute path or address"""
    digest: str
    """SHA-256 of its content"""
    damage: str
    """What cannot be read of it; empty if all can"""
    doubts: tuple[str, ...]
    """Doubts about the choice of parameters, a sentence each"""
    ticks: int
    """Approximate number of its ticks"""
    params: tuple[str, ...]
    """Parameter files as the study names them"""
    parameters: Parameters
    """Parameters that the cases share"""
    files: dict[str, str]
    """Contents of the files that parameters name"""
    vary: Callable[[CaseValues], Parameters]
    """Function that returns the parameters of a case"""

    def key(self, values: CaseValues) -> str:
        """Return the key of a case, also if its parameters are not allowed; names of files do not enter it."""
        try:
            parameters = self.vary(values)
            texts = file_texts(parameters, self.files)
            refused = []
        except UsageError:
            parameters = self.parameters
            texts = {}
            refused = sorted(values.items())
        left_out = (
            *NOT_OF_THE_RESULT,
            *([] if has_two_compartments(parameters) else [LATERAL_PREFIX]),
        )
        entries = {
            name: value
            for name, value in all_values(parameters).items()
            if not name.startswith(left_out)
        }
        entries |= {name: short_digest(text) for name, text in texts.items()}
        return short_digest(repr((answers_version(), self.digest, entries, refused)))


def groups_of(study: Study) -> list[CaseGroup]:
    """Read bags and parameters of a study.

    Raises:
        UsageError: a bag, a parameter file or a file that one names cannot be used.
    """
    found = []
    for bag, knees in itertools.groupby(study.knees, lambda knee: knee[0]):
        place = bag if is_address(bag) else str(expand_user(bag).absolute())
        with local_bag(place) as (path, digest):
            files = path.rglob("*") if path.is_dir() else [path]
            size = sum(file.stat().st_size for file in files if file.is_file())
            with Bag(path) as opened:
                weight = opened.body_weight
                damage = join_faults(opened.damage)
                doubts = (
                    () if "params" in study.model_fields_set else tuple(recorded_doubt(opened))
                )
        ticks = max(1, size // BYTES_A_TICK)
        for _, params in knees:
            parameters = with_body_weight([*params, study.values], weight)
            texts = dict[str, str]()
            file_texts(parameters, texts)
            shared = params, parameters, texts, variations_of(parameters)
            own = tuple(
                f"{' + '.join(params)}: {each}" for each in idle_doubt(parameters, study.names)
            )
            found.append(CaseGroup(bag, place, digest, damage, (*doubts, *own), ticks, *shared))
    return found


class CaseBlock(NamedTuple):
    """Cases of a group, which a worker computes together."""

    bag: str
    """The bag as the study names it"""
    params: tuple[str, ...]
    """Parameter files as the study names them"""
    place: str
    """Absolute path or address of the bag"""
    digest: str
    """SHA-256 of the bag's content"""
    parameters: Parameters
    """Parameters that the cases share"""
    files: tuple[tuple[str, str], ...]
    """Names and contents of the files that parameters name"""
    version: str
    """The client's `answers_version`"""
    number: int
    """Number of cases of the whole study"""
    series: bool
    """Whether all answers are kept too"""
    keys: tuple[str, ...]
    cases: tuple[CaseValues, ...]


def blocks_of(
    study: Study, groups: Sequence[CaseGroup], known: Container[str], used: set[str]
) -> Iterator[CaseBlock]:
    """Yield the cases that are not `known` in blocks, made on demand, and add the keys of all cases to `used`."""

    def missing_cases(group: CaseGroup) -> Iterator[tuple[str, CaseValues]]:
        for values in study.variants():
            if (key := group.key(values)) not in used:
                used.add(key)
                if key not in known:
                    yield key, values

    variants = study.number // len(groups)
    for group in groups:
        share = max(-(-variants // BLOCKS_OF_A_STUDY), MIN_BLOCK)
        size = max(1, min(share, BLOCK_TICKS // group.ticks))
        missing = missing_cases(group)
        while cases := list(itertools.islice(missing, size)):
            yield CaseBlock(
                group.bag,
                group.params,
                group.place,
                group.digest,
                group.parameters,
                tuple(sorted(group.files.items())),
                answers_version(),
                study.number,
                study.series,
                *zip(*cases, strict=True),
            )


class BlockResult(NamedTuple):
    """What a worker sends back."""

    table: bytes
    """A row for each case, as Parquet"""
    series: bytes
    """All answers as Parquet; empty unless requested"""
    failures: list[str]
    """Why cases have no outcome"""
    doubts: tuple[str, ...]
    """Doubts about the bag, a sentence each"""
    ringing: float
    """Largest ringing [N] of a contact force; 0 if there is none"""


def compute_block(block: CaseBlock) -> BlockResult:
    """Compute a block; a worker reads only the bag.

    Raises:
        UsageError: the bag cannot be used, or the worker has another version of the model.
    """
    if block.version != answers_version():
        raise UsageError(
            f"{_worker()} has another version of knee_contact_ros; install the same one"
        )
    knees = _knees(block.place, block.digest, block.parameters, block.files)
    computed = compute(knees, block.cases, series=block.series)
    if not gc.get_freeze_count():
        # Thousands of cases start many collections, which take a quarter of a second each.
        gc.freeze()
    return BlockResult(
        _parquet(_table(block, knees, computed)),
        _parquet(_series(block.keys, computed)) if block.series else b"",
        [*filter(None, computed.failed)],
        knees.recording.doubts,
        computed.ringing,
    )


@lru_cache(4)
def _knees(
    place: str, digest: str, parameters: Parameters, files: tuple[tuple[str, str], ...]
) -> Knees:
    with local_bag(place) as (path, found):
        if found != digest:
            raise UsageError(f"bag {place}: {_worker()} finds different content from the client's")
        texts = dict(files)
        with Bag(path) as bag:
            recording, _ = read_recording(bag, parameters, file_texts(parameters, texts))
        return Knees(recording, parameters, texts)


def _worker() -> str:
    from distributed import get_worker

    return f"worker {get_worker().address}"


def _table(block: CaseBlock, knees: Knees, computed: Computed) -> pd.DataFrame:
    """Make the rows of a block's cases: names, all parameters that may vary, outcomes, and why a case failed."""
    import pandas as pd

    common = {
        name: value
        for name, value in all_values(knees.parameters).items()
        if name.startswith(VARIABLE_PREFIXES)
    }
    # A named lateral parameter follows its medial one, so both columns vary.
    varied = {*block.cases[0], *(LATERAL_PREFIX + name for name in block.cases[0])}
    rows = [
        values if own is None else all_values(own)
        for own, values in zip(computed.parameters, block.cases, strict=True)
    ]
    columns = {"case": block.keys, "bag": block.bag, "params": " + ".join(block.params)} | {
        name: [row.get(name, value) for row in rows] if name in varied else value
        for name, value in common.items()
    }
    kinds = {name: type(value) for name, value in common.items()}
    outcomes = [
        pd.DataFrame(rows).add_prefix(prefix)
        for prefix, rows in zip(("", LATERAL_OUTCOME), computed.outcomes, strict=True)
    ]
    last = pd.DataFrame({"failed": computed.failed, "seconds": computed.seconds})
    table = pd.concat([pd.DataFrame(columns).astype(kinds), *outcomes, last], axis=1)
    table.attrs["varied"] = sorted(block.cases[0])
    table.attrs["units"] = units_of(table)
    table.attrs["package"] = f"knee_contact_ros {__version__}"
    return table


def _series(keys: Sequence[str], computed: Computed) -> pd.DataFrame:
    """Make the table of all answers of the cases: key, compartment, stamp [ns], and the fields of the message."""
    import pandas as pd

    parts = []
    for place, answers in enumerate(computed.series):
        known = computed.has(place)
        rows = answers[known].ravel().view(FLAT)
        fields = {name: np.ascontiguousarray(rows[name]) for name in ("stamp", *MESSAGE_FIELDS)}
        cases = np.repeat(np.array(keys)[known], answers.shape[1])
        compartment = "lateral" if place else "medial"
        parts.append(pd.DataFrame({"case": cases, "compartment": compartment, **fields}))
    return pd.concat(parts)


def _parquet(table: pd.DataFrame) -> bytes:
    content: bytes = table.to_parquet(
        None, compression="zstd", index=False, write_page_checksum=True
    )
    return content
