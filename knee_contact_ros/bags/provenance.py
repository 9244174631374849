"""How a recording came about: written into it, so that its answers can be computed again from it alone."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any, NamedTuple

import knee_contact_ros.core
from knee_contact_ros import __version__
from knee_contact_ros.bags.bag_files import files_of, is_there
from knee_contact_ros.bags.mcap_metadata import metadata_records
from knee_contact_ros.bags.writer import CONTINUED
from knee_contact_ros.parameters.curves import curve_files, read_curve, stored_texts
from knee_contact_ros.parameters.reading import flat_parameters, load_parameters
from knee_contact_ros.parameters.schema import Parameters
from knee_contact_ros.sinks.protocol import LOAD_PROVENANCE, PROVENANCE
from knee_contact_ros.system.errors import UsageError
from knee_contact_ros.system.regular_file import open_regular, sha256_of

PARAMETERS_CHANGED, RESET = "parameters_changed", "reset"
"""Names of the metadata records of what happened to a running node"""
TICK = "tick"
"""Their key for the number of ticks before"""
CURVE = "file of "
"""What a key begins with whose value is the content of a file that a parameter names"""
OURS = "knee_contact_ros "
"""How the package's name and version begin in a record of ours"""
LONGEST_COUNT = 20
"""Digits of a number of ticks"""
MOST_CHANGES = 100_000
"""Of parameters, that are made again"""
NOT_OF_THE_RESULT = ("record.", "rerun.", "diagnostics.", "autostart", "deadline")
"""Parameters (beginnings of their names) of which no answer depends"""


class Change(NamedTuple):
    """What happened to a running node between two ticks."""

    tick: int
    """Ticks in the recording before"""
    values: dict[str, Any] | None
    """Parameters that have changed; None: it was reset"""


class Provenance(NamedTuple):
    """How a recording came about, as it says itself."""

    recording: Path
    package: str
    """Name and version"""
    model: str
    """SHA-256 of the model's source"""
    parameters: Parameters
    """Those with which it began"""
    curves: dict[str, str]
    """Contents of the files that parameters name, by parameter"""
    ticks_before: int
    """Ticks that the node had computed before the recording began"""
    changes: tuple[Change, ...]
    """In their order"""
    damage: tuple[str, ...]
    """What of it cannot be read, as sentences"""

    def texts(self) -> dict[str, str]:
        """Contents of the files that its model needs.

        Raises:
            UsageError: the recording does not hold one of them.
        """
        return stored_texts(self.parameters, self.curves, self.recording)


def provenance_record(
    parameters: Parameters, curves: Mapping[str, str], source: Path | None = None, ticks_before: int = 0
) -> dict[str, str]:
    """Content of the metadata record; nothing in it depends on where or when it is written.

    `curves` gives the contents of the files that parameters name (`curve_texts`); `source` is the bag that the inputs
    come from, if they do.
    """
    values = {
        name: value for name, value in flat_parameters(parameters).items() if not name.startswith(NOT_OF_THE_RESULT)
    }
    record = {
        "package": f"knee_contact_ros {__version__}",
        "model_sha256": model_digest(),
        "parameters": json.dumps(values, indent=0),
        "ticks_before": str(ticks_before),
    }
    record |= {CURVE + name: text for name, text in curves.items()}
    return record | ({"source": source.name, "source_sha256": bag_digest(source)} if source else {})


def change_record(tick: int, values: Mapping[str, Any]) -> dict[str, str]:
    """Content of the metadata record of parameters that have changed after a number of ticks."""
    return {TICK: str(tick)} | {name: json.dumps(value) for name, value in values.items()}


def read_provenance(bag: Path) -> Provenance | None:
    """How a bag came about; None if it does not say so.

    Raises:
        UsageError: it says so, but with parameters that this version does not know, or that cannot be read; or it is a
            recording's later part.
    """
    records = list(_metadata(bag))
    found = next((values for name, values in records if name == PROVENANCE), None)
    if found is None:
        part = next((values for name, values in records if name == CONTINUED), None)
        if part is not None and not any(name == LOAD_PROVENANCE for name, _ in records):
            first = part.get("first", "another file")
            raise UsageError(
                f"{bag} goes on with {first}, which has the parameters: give the whole folder, or --params"
            )
        return None
    try:
        before, values = _count(found["ticks_before"]), _json(found["parameters"])
        package, model = found["package"], found["model_sha256"]
        if not isinstance(values, dict) or any(isinstance(value, (dict, list)) for value in values.values()):
            raise TypeError
    except (KeyError, TypeError, ValueError):
        if found.get("package", "").startswith(OURS):
            raise UsageError(
                f"{bag}: its record {PROVENANCE}, which has the parameters, is damaged: give --params"
            ) from None
        return None  # somebody else's record of the same name
    changes, damage = _changes(records, before)
    if len(changes) > MOST_CHANGES:
        raise UsageError(f"{bag} tells of {len(changes)} changes of parameters; at most {MOST_CHANGES} are made again")
    try:
        parameters = load_parameters(values)
    except UsageError as error:
        raise UsageError(f"{bag}, in its record {PROVENANCE}: {error}") from None
    curves = {key.removeprefix(CURVE): text for key, text in found.items() if key.startswith(CURVE)}
    return Provenance(bag, package, model, parameters, curves, before, tuple(changes), tuple(damage))


def with_values(provenance: Provenance, values: Mapping[str, Any]) -> Provenance:
    """A provenance with other values of some parameters, by dotted names; files that these name are read.

    Raises:
        UsageError: an unknown name, a wrong type or a value outside its range; or a file that cannot be read.
    """
    parameters = load_parameters(flat_parameters(provenance.parameters) | dict(values))
    given = {name: read_curve(name, file) for name, file in curve_files(parameters).items() if name in values}
    return provenance._replace(parameters=parameters, curves=provenance.curves | given)


def model_digest() -> str:
    """SHA-256 of the model's source."""
    return _digest(Path(knee_contact_ros.core.__file__).parent.rglob("*.py"))


def bag_digest(bag: Path) -> str:
    """SHA-256 of a bag: of its file, or of the files that its folder's metadata lists."""
    if bag.is_dir():
        return _digest(path for path in files_of(bag) if is_there(path))
    with open_regular(bag) as file:
        return sha256_of(file)


def _digest(paths: Iterable[Path]) -> str:
    """A digest of files' names and contents, in the order of their names."""
    digest = hashlib.sha256()
    for path in sorted(paths):
        with open_regular(path) as file:
            digest.update(f"{path.name} {sha256_of(file)}\n".encode())
    return digest.hexdigest()


def _changes(records: Iterable[tuple[str, dict[str, str]]], before: int) -> tuple[list[Change], list[str]]:
    """What happened after a number of ticks, in order, and what of it cannot be read."""
    changes, damage = [], []
    for name, values in records:
        if name not in (RESET, PARAMETERS_CHANGED):
            continue
        try:
            tick = _count(values[TICK]) - before
            changed = {key: _json(value) for key, value in values.items() if key != TICK}
        except (KeyError, ValueError):
            when = f" (tick {values[TICK]})" if values.get(TICK) else ""
            damage.append(f"a record {name}{when} is damaged, and what it tells of is not done again")
            continue
        changes.append(Change(tick, changed if name == PARAMETERS_CHANGED else None))
    return sorted(changes, key=lambda change: change.tick), damage


def _count(text: str) -> int:
    """A number of ticks.

    Raises:
        ValueError: the text is none.
    """
    if len(text) > LONGEST_COUNT:
        raise ValueError("too many digits")
    return int(text)


def _json(text: str) -> Any:
    """A value.

    Raises:
        ValueError: the text is none.
    """
    try:
        return json.loads(text)
    except RecursionError:
        raise ValueError("nested too deep") from None


def _metadata(bag: Path) -> Iterator[tuple[str, dict[str, str]]]:
    """Names and contents of the metadata records of a bag's MCAP files; none of those that cannot be read."""
    for path in files_of(bag):
        try:
            found = metadata_records(path)
        except OSError:
            continue
        yield from ((record.name, record.metadata) for record in found)
