"""What is missing of a study, in blocks: equal ones for all clients that share a folder, from where each begins.

So two clients seldom compute the same, and what one has written the other passes over.
"""

from __future__ import annotations

import json
import random
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

from knee_contact_ros.cohort.keys import case_key, refused_key, shard_name
from knee_contact_ros.cohort.knees import Files
from knee_contact_ros.cohort.places import absolute, digest_of, here
from knee_contact_ros.cohort.study import Group, Study
from knee_contact_ros.cohort.work import Aim, Block, Source
from knee_contact_ros.parameters.curves import curve_files, read_curve
from knee_contact_ros.parameters.reading import all_values, load_parameters, variations_of
from knee_contact_ros.parameters.schema import Parameters
from knee_contact_ros.system.errors import UsageError

TICKS_A_BLOCK = 800_000
"""Of a block of cases: more than a tenth of a second of a worker, ten times what a block costs by itself"""
LEAST, PARTS = 8, 16
"""Cases of a block at least, and into how many blocks a small study is divided"""
BLOCKS_A_STRETCH = 4
"""Whose keys are made before the first of them is computed"""
NAME_FILES = (".profile", ".table", ".share_file")
"""How the names of parameters end that name files"""
BYTES_A_TICK = 100
"""Of a bag at most, compressed"""


class Bag(NamedTuple):
    """A recording of a study."""

    place: str
    digest: str
    ticks: int
    """About so many"""


class Knee(NamedTuple):
    """A recording with one set of parameter files."""

    group: Group
    bag: Bag
    parameters: Parameters


def knees_of(study: Study) -> list[Knee]:
    """All that a study's cases have in common, by recording and parameter files.

    Raises:
        UsageError: a bag, a parameter file or a file that one names cannot be used.
    """
    bags = {bag: _bag(bag) for bag in study.bags}
    parameters = {params: load_parameters([*params, study.values]) for params in study.params}
    for one in parameters.values():
        Files().texts(one)
    for name, own in study.grid.items():
        for file in own if name.endswith(NAME_FILES) else []:
            read_curve(name, file)
    return [Knee(group, bags[group.bag], parameters[group.params]) for group in study.groups()]


def _bag(name: str) -> Bag:
    place = absolute(name)
    with here(place) as path:
        return Bag(place, digest_of(name, path), max(1, _size(path) // BYTES_A_TICK))


def _size(path: Path) -> int:
    files = [file for file in path.rglob("*") if file.is_file()] if path.is_dir() else [path]
    return sum(file.stat().st_size for file in files)


def keys_of(study: Study) -> list[str]:
    """The keys of all cases, in the order of their numbers.

    Raises:
        UsageError: see `knees_of`.
    """
    files = Files()
    return [case.key for knee in knees_of(study) for case in _keyed(study, knee, knee.group.numbers, files)]


class Keyed(NamedTuple):
    """A case, as the client knows it: its parameters are the workers'."""

    number: int
    key: str
    files: tuple[str, ...]
    """Names of those that its parameters name"""


def _keyed(study: Study, knee: Knee, numbers: range, files: Files) -> Iterator[Keyed]:
    """Cases by their numbers; those whose parameters are not allowed, too."""
    varied = variations_of(knee.parameters)
    for number in numbers:
        values = dict(zip(study.names, study.row(number), strict=True))
        named: tuple[str, ...] = ()
        try:
            parameters = varied(values)
            key = case_key(knee.bag.digest, parameters, files.texts(parameters))
            named = tuple(curve_files(parameters).values())
        except UsageError:
            key = refused_key(knee.bag.digest, knee.parameters, values)
        yield Keyed(number, key, named)


class Missing:
    """Blocks of what is not there, as they are asked for."""

    def __init__(self, study: Study, knees: list[Knee], there: set[str], aim: Aim) -> None:
        """Of a study, whose cases of these keys are there."""
        self._study, self._knees, self._there, self._aim = study, knees, there, aim
        self._files = Files()
        self.there = 0
        """Cases, so far, that were there, or are the same as another"""

    def __iter__(self) -> Iterator[Block]:
        stretches = [(knee, own) for knee in self._knees for own in _stretches(knee)]
        for knee, numbers in _from_anywhere(stretches):
            missing = self._missing(knee, numbers)
            size = _size_of_block(knee)
            parts = [missing[begin : begin + size] for begin in range(0, len(missing), size)]
            yield from (self._block(knee, part) for part in _from_anywhere(parts))

    def _missing(self, knee: Knee, numbers: range) -> list[Keyed]:
        """The cases that are not there."""
        missing = []
        for case in _keyed(self._study, knee, numbers, self._files):
            if case.key in self._there:
                self.there += 1
            else:
                self._there.add(case.key)
                missing.append(case)
        return missing

    def _block(self, knee: Knee, cases: list[Keyed]) -> Block:
        keys = tuple(case.key for case in cases)
        self._files.texts(knee.parameters)
        named = set(curve_files(knee.parameters).values()).union(*(case.files for case in cases))
        files = tuple((name, self._files.known[name]) for name in sorted(named))
        values = json.dumps(all_values(knee.parameters))
        rows = tuple(self._study.row(case.number) for case in cases)
        return Block(
            self._aim, Source(knee.bag.place, knee.bag.digest, values, files), (knee.group.bag, knee.group.params),
            tuple(self._study.names), rows, keys, shard_name(keys),
        )  # fmt: skip


def _size_of_block(knee: Knee) -> int:
    shared = -(-len(knee.group.numbers) // PARTS)
    return max(1, min(max(shared, LEAST), TICKS_A_BLOCK // knee.bag.ticks))


def _stretches(knee: Knee) -> list[range]:
    numbers, size = knee.group.numbers, BLOCKS_A_STRETCH * _size_of_block(knee)
    return [numbers[begin : begin + size] for begin in range(0, len(numbers), size)]


def _from_anywhere(things: list[Any]) -> list[Any]:
    """All of them, from one on that is drawn."""
    begin = random.randrange(len(things)) if things else 0  # noqa: S311
    return [*things[begin:], *things[:begin]]
