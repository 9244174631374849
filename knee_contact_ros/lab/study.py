"""A study: all combinations of bags, parameter files and varied values; Dask computes blocks, each a Parquet file.

A study file (YAML) has

    bags:   [walking.mcap, "s3://gait/running.mcap"]       # files, folders, or what fsspec opens
    params: [healthy, [osteoarthritis, mri_femur.yaml]]    # each a knee: a file, or several; later ones override
    values: {fidelity.tolerance: 1.0e-8}                   # of all knees
    grid:   {contact.layer_depth: [0.25e-3, 0.5e-3], load.share: {from: 0.5, to: 0.8, number: 7}}
    sample: {method: sobol, n: 1024, seed: 1, ranges: {contact.stiffness: [5.0e7, 1.0e8], contact.damping: {from: 1.0e3,
             to: 1.0e4, scale: log}}}
    series: true                                           # also keep all answers of every case

Only `bags` is required. Workers read bags and send tables back; only the client writes. The output folder is a Parquet
dataset of files (shards), named by their cases, which appear when complete. Names of incomplete files and of the folder
of all answers begin with an underscore, which readers of datasets skip. A row has a column for every parameter that a
study may vary: it describes its knee completely, and tables of several studies can be joined.
"""

from __future__ import annotations

import errno
import gc
import hashlib
import itertools
import logging
import math
import re
import signal
from collections import Counter
from collections.abc import Callable, Container, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager, suppress
from functools import lru_cache
from multiprocessing import resource_tracker
from pathlib import Path, PurePosixPath
from tempfile import TemporaryDirectory
from typing import Annotated, Any, Literal, NamedTuple, TypeVar

import numpy as np
from pydantic import (
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Field,
    ValidationError,
    model_validator,
)

from knee_contact_ros.bags.provenance import NOT_OF_THE_RESULT, bag_digest, model_digest, weight_of
from knee_contact_ros.bags.reader import BagReader
from knee_contact_ros.lab.sweep import (
    LATERAL,
    OF_A_RUN,
    SECTIONS,
    Computed,
    Knees,
    checked_names,
    compute,
    file_texts,
    read_recording,
    recorded_doubt,
)
from knee_contact_ros.model.kernel import worth_compiling
from knee_contact_ros.model.types import FLAT, MESSAGE_FIELDS, Floats
from knee_contact_ros.offline.solve import with_weight
from knee_contact_ros.parameters.files import (
    all_values,
    check_value,
    dotted,
    first_error,
    known_parameters,
    variations_of,
)
from knee_contact_ros.parameters.schema import LATERAL as LATERAL_KNEE
from knee_contact_ros.parameters.schema import Parameters, has_both
from knee_contact_ros.system.errors import CommandError, IncompleteError, UsageError, join_faults
from knee_contact_ros.system.files import expand_user, read_mapping
from knee_contact_ros.system.progress import progress
from knee_contact_ros.system.terminal import say, warn

Values = dict[str, Any]
S = TypeVar("S", bound="Study")
MOST = 10_000_000
"""Largest number of cases of a study"""
ADDRESS = re.compile("://|::")
"""Marks an address for fsspec (`s3://...`, `zip://gait.mcap::https://...`) rather than a path"""
MEANING = 3
"""Version of the outcomes' definitions and of the keys: increase it when a column is computed differently"""
SERIES, UNFINISHED = "_series", "_unfinished"
"""Names in a study's folder: the folder of all answers, and a file that is being written"""
FULL = {errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EIO}
"""Errors that are not the user's fault"""
TICKS, LEAST, PARTS = 800_000, 8, 16
"""Ticks of a block (more than a tenth of a second of a worker's time, ten times its overhead), least number of cases in
a block, and number of blocks into which a small study is divided"""
BYTES_A_TICK = 100
"""Largest size of a tick in a compressed bag [B]"""
PATIENCE = 10.0
"""Time [s] that a scheduler has to answer"""
WAITING = 4
"""Blocks submitted per thread of the workers, so that a cluster that scales itself sees the work waiting"""
REST = "finished cases are kept; the same command computes the rest"
LOGS = ("distributed", "tornado", "asyncio")
DASK: dict[str, object] = (
    {f"logging.{name}": "critical" for name in LOGS}
    | {f"distributed.{part}.http.routes": [] for part in ("scheduler", "worker", "nanny")}
    | {
        "distributed.nanny.pre-spawn-environ.MALLOC_TRIM_THRESHOLD_": None,
        "distributed.worker.profile.enabled": False,
    }
)
"""Settings: no logs, no web page, no profiler, and workers keep freed memory that they soon need again"""


class Part(BaseModel):
    """Section of a study file."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


class Spaced(Part):
    """Evenly spaced values between two ends, or values whose logarithms are evenly spaced."""

    start: float = Field(alias="from")
    stop: float = Field(alias="to")
    number: int = Field(2, ge=2, le=MOST)
    scale: Literal["linear", "log"] = "linear"

    @model_validator(mode="before")
    @classmethod
    def _pair(cls, given: Any) -> Any:
        if isinstance(given, list | tuple) and len(given) == 2:
            return {"from": given[0], "to": given[1]}
        if not isinstance(given, Mapping):
            raise ValueError("a list of two numbers, or from, to and scale")  # noqa: TRY004  (as pydantic asks)
        return given

    @model_validator(mode="after")
    def _in_order(self) -> Spaced:
        if not self.start < self.stop or (self.scale == "log" and self.start <= 0.0):
            raise ValueError(
                "0 < from < to is required" if self.scale == "log" else "from < to is required"
            )
        return self

    def at(self, fractions: Floats) -> Floats:
        """Return the values at fractions of the range, 0 at its beginning and 1 at its end."""
        if self.scale == "linear":
            values = self.start + (self.stop - self.start) * fractions
        else:
            values = np.exp(math.log(self.start) + math.log(self.stop / self.start) * fractions)
        return np.asarray(
            np.clip(values, self.start, self.stop)
        )  # rounding must not leave what is allowed


def _listed(given: Any) -> Any:
    """Return the values of a range in a grid, both ends included; a list stays as it is."""
    if not isinstance(given, Mapping):
        return given
    try:
        axis = Spaced.model_validate(given)
    except ValidationError as error:
        raise ValueError(error.errors()[0]["msg"].removeprefix("Value error, ")) from None
    return [axis.start, *axis.at(np.linspace(0.0, 1.0, axis.number))[1:-1].tolist(), axis.stop]


class Design(Part):
    """Points at which several parameters vary together; a subclass draws them in the unit cube."""

    method: str
    """How the points are drawn; checked first, so that a wrong method is reported first"""
    n: int = Field(ge=1, le=MOST)
    """Number of groups of points"""
    seed: int = Field(0, ge=0)
    ranges: Annotated[dict[str, Spaced], Field(min_length=1)]
    """Range of each parameter by name: two numbers, or a mapping with `from` and `to`"""

    @property
    def number(self) -> int:
        """Number of points."""
        return self.n

    def unit(self) -> Floats:
        """Draw points in the unit cube, shape (number, parameters); every call gives the same points."""
        raise NotImplementedError

    def points(self) -> Floats:
        """Return the parameters' values at the points, shape (number, parameters)."""
        columns = zip(self.ranges.values(), self.unit().T, strict=True)
        return np.column_stack([axis.at(fractions) for axis, fractions in columns])


class Sample(Design):
    """Points drawn in ranges; a larger `sobol` or `random` sample begins with the points of a smaller one."""

    method: Literal["latin_hypercube", "sobol", "random"] = "latin_hypercube"

    def unit(self) -> Floats:
        """See `Design.unit`."""
        size = len(self.ranges)
        if self.method == "random":
            return np.random.default_rng(self.seed).random((self.n, size))
        from scipy.stats import qmc  # takes half a second to import

        if self.method == "latin_hypercube":
            return np.asarray(qmc.LatinHypercube(size, seed=self.seed).random(self.n))
        return np.asarray(
            qmc.Sobol(size, seed=self.seed).random_base2(math.ceil(math.log2(self.n)))[: self.n]
        )


class Study(Part):
    """Content of a study file. Cases are in the order of bag, parameter files, then values: the last changes fastest.

    Raises:
        UsageError: something is given twice, a parameter is unknown, or a value is not allowed.
    """

    bags: Annotated[list[str], Field(min_length=1)]
    params: Annotated[list[str | list[str]], Field(min_length=1)] = ["healthy"]
    values: Annotated[
        Values,
        BeforeValidator(lambda given: dotted(given) if isinstance(given, Mapping) else given),
    ] = {}
    grid: dict[str, Annotated[list[Any], BeforeValidator(_listed), Field(min_length=1)]] = {}
    sample: Sample | None = None
    series: bool = False

    @property
    def design(self) -> Design | None:
        """The points at which parameters vary together."""
        return self.sample

    @property
    def names(self) -> list[str]:
        """Names of the varied parameters."""
        return [*self.grid, *(self.design.ranges if self.design else ())]

    @property
    def knees(self) -> list[tuple[str, tuple[str, ...]]]:
        """Each bag with each set of parameter files."""
        sets = [(one,) if isinstance(one, str) else tuple(one) for one in self.params]
        return list(itertools.product(self.bags, sets))

    @property
    def number(self) -> int:
        """Number of cases."""
        variants = math.prod(map(len, self.grid.values())) * (
            self.design.number if self.design else 1
        )
        return len(self.knees) * variants

    def variants(self) -> Iterator[Values]:
        """Return the values of the varied parameters, the same for each of `knees`."""
        points = self.design.points().tolist() if self.design else [[]]
        for values, point in itertools.product(itertools.product(*self.grid.values()), points):
            yield dict(zip(self.names, (*values, *point), strict=True))

    @model_validator(mode="after")
    def _check(self) -> Study:
        if self.number > MOST:
            raise UsageError(f"{self.number} cases are not allowed; {MOST} at most")
        ranges, known = self.design.ranges if self.design else {}, known_parameters()
        given = [
            *self.names,
            *self.values,
            *(f"{bag} with {list(params)}" for bag, params in self.knees),
        ]
        given += [f"{name} {value!r}" for name, values in self.grid.items() for value in values]
        if twice := [one for one, count in Counter(given).items() if count > 1]:
            raise UsageError(f"{twice[0]} is given twice")
        checked_names(self.names)
        if whole := [
            name for name in ranges if name in known and not isinstance(known[name].default, float)
        ]:
            raise UsageError(
                f"{whole[0]}: a range is not allowed; only a real number can have one"
            )
        ends = {name: [axis.start, axis.stop] for name, axis in ranges.items()}
        for name, allowed in (
            self.grid | ends | {name: [value] for name, value in self.values.items()}
        ).items():
            for value in allowed:
                check_value(name, value)
        return self


def read_study(path: Path, kind: type[S]) -> S:
    """Read a study file.

    Raises:
        UsageError: the file cannot be read, or see `Study`.
    """
    content = read_mapping(path, "study", "bags, params, grid or sample")
    try:
        return kind.model_validate(dict(content))
    except ValidationError as error:
        raise UsageError(f"{path}: {first_error(error)}") from None
    except UsageError as error:
        raise UsageError(f"{path}: {error}") from None


@contextmanager
def here(place: str) -> Iterator[tuple[Path, str]]:
    """Return the path of a bag on this machine and the SHA-256 of its content.

    A bag at an address is copied while the context lasts.

    Raises:
        UsageError: the bag cannot be fetched or read.
    """
    import fsspec

    with TemporaryDirectory(prefix="knee_contact_bag_") as folder:
        path = expand_user(place)
        try:
            if ADDRESS.search(place):
                files, inner = fsspec.core.url_to_fs(place)
                path = Path(folder) / (PurePosixPath(str(inner)).name or "bag")
                files.get(inner, str(path), recursive=bool(files.isdir(inner)))
            digest = bag_digest(path)
        except Exception as error:  # a boundary: each kind of store has errors of its own
            cannot = "cannot be fetched: " if ADDRESS.search(place) else ""
            raise UsageError(f"bag {place}: {cannot}{reason(error)}") from None
        yield path, digest


def reason(error: BaseException) -> str:
    """Describe an error in a few words."""
    return getattr(error, "strerror", None) or str(error) or type(error).__name__


@lru_cache
def what_answers() -> str:
    """Return a digest of the model's source and of the outcomes' definitions, which is part of every key."""
    return _digest(repr((model_digest(), MEANING, OF_A_RUN.names)))


@lru_cache(64)
def _digest(content: str) -> str:
    return hashlib.sha256(content.encode()).hexdigest()[:32]


def groups_of(study: Study) -> list[Group]:
    """Read bags and parameters of a study.

    Raises:
        UsageError: a bag, a parameter file or a file that one names cannot be used.
    """
    found = []
    for name, several in itertools.groupby(study.knees, lambda knee: knee[0]):
        place = name if ADDRESS.search(name) else str(expand_user(name).absolute())
        with here(place) as (path, digest):
            files = (
                [file for file in path.rglob("*") if file.is_file()] if path.is_dir() else [path]
            )
            ticks, weight = (
                max(1, sum(file.stat().st_size for file in files) // BYTES_A_TICK),
                weight_of(path),
            )
            with BagReader(path, {}) as reader:
                damage = join_faults(reader.damage)
            doubts = () if "params" in study.model_fields_set else tuple(recorded_doubt(path))
        for bag, params in several:
            parameters, texts = with_weight([*params, study.values], weight), dict[str, str]()
            file_texts(parameters, texts)
            own = params, parameters, texts, variations_of(parameters)
            found.append(Group(bag, place, digest, damage, doubts, ticks, *own))
    return found


class Group(NamedTuple):
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
    varied: Callable[[Values], Parameters]
    """Function that returns the parameters of a case"""

    def key(self, values: Values) -> str:
        """Return the key of a case, also if its parameters are not allowed; names of files do not enter it."""
        try:
            parameters, rest = self.varied(values), []
            texts = file_texts(parameters, self.files)
        except UsageError:
            parameters, texts, rest = self.parameters, {}, sorted(values.items())
        left_out = (
            NOT_OF_THE_RESULT if has_both(parameters) else (*NOT_OF_THE_RESULT, LATERAL_KNEE)
        )
        counted = {
            name: own
            for name, own in all_values(parameters).items()
            if not name.startswith(left_out)
        }
        counted |= {name: _digest(text) for name, text in texts.items()}
        return _digest(repr((what_answers(), self.digest, counted, rest)))


class Block(NamedTuple):
    """Cases of a group, which a worker computes together."""

    bag: str
    params: tuple[str, ...]
    """Bag and parameter files as the study names them"""
    inputs: tuple[str, str, Parameters, tuple[tuple[str, str], ...]]
    """Place and digest of the bag, parameters that the cases share, and names and contents of files"""
    model: str
    """Digest of the client's model, see `what_answers`"""
    number: int
    """Number of cases of the whole study"""
    series: bool
    """Whether all answers are kept too"""
    keys: tuple[str, ...]
    cases: tuple[Values, ...]


def blocks_of(
    study: Study, groups: Sequence[Group], known: Container[str], used: set[str]
) -> Iterator[Block]:
    """Yield the cases that are not `known` in blocks, made on demand, and add the keys of all cases to `used`."""

    def missing(group: Group) -> Iterator[tuple[str, Values]]:
        for values in study.variants():
            if (key := group.key(values)) not in used:
                used.add(key)
                if key not in known:
                    yield key, values

    variants = study.number // len(groups)
    for group in groups:
        size, left = (
            max(1, min(max(-(-variants // PARTS), LEAST), TICKS // group.ticks)),
            missing(group),
        )
        while cases := list(itertools.islice(left, size)):
            inputs = (
                group.place,
                group.digest,
                group.parameters,
                tuple(sorted(group.files.items())),
            )
            yield Block(
                group.bag,
                group.params,
                inputs,
                what_answers(),
                study.number,
                study.series,
                *zip(*cases, strict=True),
            )


Answered = tuple[bytes, bytes, list[str], tuple[str, ...]]
"""What a worker sends back: a row for each case as Parquet; all answers as Parquet, if requested; why cases have no
outcome; and doubts about the bag, a sentence each"""


def compute_block(block: Block) -> Answered:
    """Compute a block; a worker reads only the bag.

    Raises:
        UsageError: the bag cannot be used, or the worker has another version of the model.
    """
    if block.model != what_answers():
        raise UsageError(
            f"{_worker()} has another version of knee_contact_ros; install the same one"
        )
    knees = _knees(*block.inputs)
    compiled = worth_compiling(block.number * len(knees.recording.steps))
    computed = compute(knees, block.cases, series=block.series, compiled=compiled)
    if (
        not gc.get_freeze_count()
    ):  # thousands of cases start many collections, a quarter of a second each
        gc.freeze()
    series = _series(block.keys, computed) if block.series else b""
    return (
        _table(block, knees, computed),
        series,
        [*filter(None, computed.failed)],
        knees.recording.doubts,
    )


@lru_cache(4)
def _knees(
    place: str, digest: str, parameters: Parameters, files: tuple[tuple[str, str], ...]
) -> Knees:
    with here(place) as (path, found):
        if found != digest:
            raise UsageError(f"bag {place}: {_worker()} finds different content from the client's")
        known = dict(files)
        return Knees(
            read_recording(path, parameters, file_texts(parameters, known))[0], parameters, known
        )


def _worker() -> str:
    from distributed import get_worker

    return f"worker {get_worker().address}"


def _table(block: Block, knees: Knees, computed: Computed) -> bytes:
    """Make the rows of a block's cases: names, all parameters that may vary, outcomes, and why a case failed."""
    import pandas as pd

    common = {
        name: value
        for name, value in all_values(knees.parameters).items()
        if name.startswith(SECTIONS)
    }
    varied = {*block.cases[0], *(LATERAL_KNEE + name for name in block.cases[0])}
    rows = [
        values if own is None else all_values(own)
        for own, values in zip(computed.parameters, block.cases, strict=True)
    ]
    before = {"case": block.keys, "bag": block.bag, "params": " + ".join(block.params)}
    columns = {
        name: [row.get(name, value) for row in rows] if name in varied else value
        for name, value in common.items()
    }
    outcomes = [
        pd.DataFrame(rows).add_prefix(prefix)
        for prefix, rows in zip(("", LATERAL), computed.outcomes, strict=True)
    ]
    after = pd.DataFrame({"failed": computed.failed, "seconds": computed.seconds})
    kinds = {name: type(value) for name, value in common.items()}
    table = pd.concat([pd.DataFrame(before | columns).astype(kinds), *outcomes, after], axis=1)
    table.attrs["varied"] = sorted(block.cases[0])
    content: bytes = table.to_parquet(
        None, compression="zstd", index=False, write_page_checksum=True
    )
    return content


def _series(keys: Sequence[str], computed: Computed) -> bytes:
    """Make the table of all answers of the cases: key, compartment, stamp [ns], and the fields of the message."""
    import pandas as pd

    parts = []
    for place, (side, answers) in enumerate(
        zip(("medial", "lateral"), computed.series, strict=False)
    ):
        known = computed.has(place)
        rows = answers[known].ravel().view(FLAT)
        columns = {name: np.ascontiguousarray(rows[name]) for name in ("stamp", *MESSAGE_FIELDS)}
        cases = np.repeat(np.array(keys)[known], answers.shape[1])
        parts.append(pd.DataFrame({"case": cases, "compartment": side, **columns}))
    content: bytes = pd.concat(parts).to_parquet(
        None, compression="zstd", index=False, write_page_checksum=True
    )
    return content


class Shards:
    """Reads and writes the shards in a study's output folder, which need not exist yet."""

    def __init__(self, url: str) -> None:
        """Take a folder.

        Raises:
            UsageError: the address cannot be used.
        """
        import fsspec

        self.url = url
        with self.errors():
            place = url if ADDRESS.search(url) else str(expand_user(url).absolute())
            self.files, self.folder = fsspec.core.url_to_fs(place, use_listings_cache=False)
            if self.files.isfile(self.folder):
                raise UsageError(f"output {url}: is a file; a folder is needed")

    @contextmanager
    def errors(self) -> Iterator[None]:
        """Turn errors in reading or writing the folder into one line that names it."""
        try:
            yield
        except CommandError:
            raise
        except Exception as error:  # a boundary: each kind of store has errors of its own
            full = isinstance(error, OSError) and error.errno in FULL
            raise (IncompleteError if full else UsageError)(
                f"output {self.url}: {reason(error)}"
            ) from None

    def names(self, folder: str = "") -> list[str]:
        """Names of the shards in the folder of results, or in a folder inside it.

        Raises:
            UsageError: the folder contains something else.
        """
        with self.errors():
            try:
                found = self.files.ls(f"{self.folder}/{folder}".rstrip("/"), detail=False)
            except FileNotFoundError:
                return []
        entries = [PurePosixPath(name.rstrip("/")).name for name in found]
        names = sorted(name for name in entries if not name.startswith(("_", ".")))
        for name in names:
            if not (name.startswith("cases-") and name.endswith(".parquet")):
                raise UsageError(
                    f"output {self.url}: holds {name}, which is not a result of a study"
                )
        return names

    def read(self, *columns: str) -> Any:
        """Read columns of all finished cases into a data frame, by their keys.

        Raises:
            UsageError: the folder contains something else, or a shard is damaged.
        """
        import pandas as pd
        import pyarrow as pa
        import pyarrow.parquet as pq

        parts = [pd.DataFrame({"case": []})]
        for name in self.names():
            try:  # from bytes: Arrow's threads would release a Python file after Python's end, and abort
                content = pa.BufferReader(self.files.cat_file(f"{self.folder}/{name}"))
                whole = pq.read_table(
                    content, page_checksum_verification=True
                )  # damage anywhere is found
                parts.append(whole.select(["case", *columns]).to_pandas())
            except Exception as error:  # a boundary: damaged files raise what they like
                why = reason(error).splitlines()[0]
                raise UsageError(
                    f"output {self.url}: {name} is damaged, or is not a result of a study ({why}): move it away, and "
                    "its cases are computed again"
                ) from None
        return pd.concat(parts[1:] or parts).drop_duplicates("case").set_index("case")

    def put(self, name: str, content: bytes) -> None:
        """Write a file; it gets its name when it is complete.

        Raises:
            UsageError: the folder cannot be written.
            IncompleteError: the disk is full.
        """
        unfinished = f"{self.folder}/{UNFINISHED}"
        with self.errors():
            try:
                self.files.makedirs(f"{self.folder}/{name}".rpartition("/")[0], exist_ok=True)
                self.files.pipe_file(unfinished, content)
                self.files.mv(unfinished, f"{self.folder}/{name}")
            except BaseException:
                with suppress(Exception):
                    self.files.rm(unfinished)
                raise


@contextmanager
def workers_of(number: int, scheduler: str) -> Iterator[Any]:
    """Connect to a running scheduler, or start workers on this machine until the context ends; yield the client.

    Args:
        number: Processes on this machine; 0: one for each processor.
        scheduler: Address of the scheduler to use instead; empty for workers on this machine.

    Raises:
        UsageError: the scheduler cannot be reached.
        IncompleteError: no process can be started.
    """
    from dask import config
    from distributed import (
        Client,
        LocalCluster,
    )  # before the settings: it adds its own, which must outlive the context
    from distributed.comm import parse_address
    from distributed.comm.registry import get_backend

    with ExitStack() as opened:
        opened.enter_context(config.set(DASK))
        for name in [name for name in logging.root.manager.loggerDict if name.startswith(LOGS)]:
            logging.getLogger(name).setLevel(logging.CRITICAL)
        try:
            if scheduler:  # a client of an unknown kind of address would wait for it at the end
                get_backend(parse_address(scheduler)[0])
            with _ignoring_interrupts():
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
            client = opened.enter_context(Client(cluster, timeout=PATIENCE, set_as_default=False))
        except (
            Exception
        ) as error:  # a boundary: an address may be of a kind that needs another library
            if scheduler:
                raise UsageError(
                    f"scheduler {scheduler}: cannot be reached: {reason(error)}"
                ) from None
            raise IncompleteError(f"no workers can be started: {reason(error)}") from None
        if scheduler and not client.nthreads():
            warn([f"scheduler {scheduler}: it has no workers yet; waiting"])
        yield client


@contextmanager
def _ignoring_interrupts() -> Iterator[None]:
    """Make processes and threads that start in this context ignore Ctrl-C; the client receives it and ends them."""
    resource_tracker.ensure_running()  # it lets the signal through again in the thread that it is started by
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def computed_by(client: Any, blocks: Iterator[Block]) -> Iterator[tuple[Block, Answered]]:
    """Let the workers compute blocks; yield each with its answers when it is done.

    Raises:
        UsageError: a worker cannot use a bag.
        IncompleteError: workers died repeatedly or failed, or the scheduler is gone.
    """
    from distributed import as_completed
    from distributed.scheduler import KilledWorker

    running, of_future, future = as_completed(loop=client.loop), dict[str, Block](), None

    def submit() -> None:
        wanted = WAITING * max(8, sum(client.nthreads().values())) - len(of_future)
        for block in itertools.islice(blocks, max(0, wanted)):
            submitted = client.submit(compute_block, block, pure=False)
            of_future[submitted.key] = block
            running.add(submitted)

    try:
        submit()
        for future in running:
            block = of_future.pop(future.key)
            answered = future.result()
            future.release()
            yield block, answered
            submit()
    except CommandError:
        raise
    except KilledWorker:
        where = f"{len(block.keys)} cases of bag {block.bag}"
        raise IncompleteError(
            f"workers died repeatedly at {where}: is there too little memory? {REST}"
        ) from None
    except (
        Exception
    ) as error:  # a boundary: whatever a worker may lack or meet; or the scheduler is gone
        if future is None or future.status != "error":
            raise IncompleteError(f"the scheduler no longer answers; {REST}") from None
        failure = f"{type(error).__name__}: {reason(error)}"
        raise IncompleteError(f"bag {block.bag}: a worker failed: {failure}; {REST}") from None


def run_study(
    study: Study, output: str, workers: int = 0, scheduler: str = ""
) -> tuple[int, int, int, str]:
    """Compute the missing cases of a study, with a bar, and say how many there were.

    Args:
        study: The study.
        output: Folder of the results, local or as fsspec spells it.
        workers: Processes on this machine; 0: one for each processor.
        scheduler: Address of a scheduler whose workers compute instead, as `tcp://host:8786`.

    Returns:
        Numbers of cases: those that were there before or are the same as another one, those computed now, and all that
        have no outcome; and what is missing of the work, empty if it is whole.

    Raises:
        UsageError: bag, parameters, folder or scheduler cannot be used.
        IncompleteError: a disk is full, or workers died repeatedly.
    """
    count, failed, doubts, used, shards = (
        0,
        list[str](),
        dict[str, None](),
        set[str](),
        Shards(output),
    )
    with progress("Computing") as advance:
        groups, known = groups_of(study), dict(shards.read("failed").get("failed", {}))
        if study.series and set(shards.names()) - set(shards.names(SERIES)):
            raise UsageError(
                f"output {output}: holds cases without their series; use a new folder"
            )
        for name in set(shards.names(SERIES)) - set(shards.names()) if study.series else ():
            with shards.errors():  # its cases are computed again
                shards.files.rm_file(f"{shards.folder}/{SERIES}/{name}")
        doubts |= dict.fromkeys(
            f"bag {group.bag}: {sentence}" for group in groups for sentence in group.doubts
        )
        blocks = blocks_of(study, groups, known, used)
        if first := next(blocks, None):
            with workers_of(workers, scheduler) as client:
                for block, (table, series, why, doubted) in computed_by(
                    client, itertools.chain([first], blocks)
                ):
                    name = f"cases-{_digest(' '.join(block.keys))}.parquet"
                    if study.series:
                        shards.put(f"{SERIES}/{name}", series)
                    shards.put(name, table)
                    count, failed = count + len(block.keys), failed + why
                    doubts |= dict.fromkeys(f"bag {block.bag}: {sentence}" for sentence in doubted)
                    advance(count, study.number)
    warn(doubts)
    failed += [known[key] for key in used if known.get(key)]
    there, same = len(used) - count, study.number - len(used)
    others = f"{same} the same as others, " if same else ""
    say(
        f"{study.number} cases: {count} computed, {there} were there already, {others}{len(failed)} failed"
    )
    missing = [f"{len(failed)} of {len(used)} cases failed: {min(failed)}"] if failed else []
    missing += [
        f"bag {group.bag} is damaged, and computed as far as it can be read: {group.damage}"
        for group in groups
        if group.damage
    ]
    return there + same, count, len(failed), "; ".join(dict.fromkeys(missing))
