"""The cases of a study that are still missing, in blocks that are sent to workers.

All clients that share a folder divide a study into the same blocks, and each begins at a random one. So two clients
seldom compute the same block, and each skips what the other has written.
"""

from __future__ import annotations

import json
import random
from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple, TypeVar

from knee_contact_ros.cohort.keys import case_key, refused_key, shard_name
from knee_contact_ros.cohort.knees import Files
from knee_contact_ros.cohort.places import absolute, digest_of, here
from knee_contact_ros.cohort.study import Group, Study
from knee_contact_ros.cohort.work import Block, Source, Target
from knee_contact_ros.parameters.curves import curve_files, read_curve
from knee_contact_ros.parameters.reading import all_values, load_parameters, variations_of
from knee_contact_ros.parameters.schema import Parameters
from knee_contact_ros.system.errors import UsageError

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
