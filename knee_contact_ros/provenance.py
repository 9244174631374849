"""How a recording came about: written into it, so that its answers can be computed again from it alone."""

from __future__ import annotations

import hashlib
import json
import struct
from collections.abc import Iterable, Iterator, Mapping
from contextlib import closing
from pathlib import Path
from typing import Any, NamedTuple

from mcap.exceptions import McapError
from mcap.reader import make_reader
from mcap.records import Metadata

import knee_contact_ros.core
from knee_contact_ros import __version__
from knee_contact_ros.errors import UsageError
from knee_contact_ros.parameters import Parameters, flat_parameters, load_parameters
from knee_contact_ros.record import CONTINUED
from knee_contact_ros.record_answers import PROVENANCE
from knee_contact_ros.salvage.inspection import files_of, open_file
from knee_contact_ros.salvage.mcap_file import McapFile

PARAMETERS_CHANGED, RESET = "parameters_changed", "reset"
"""Names of the metadata records of what happened to a running node"""
TICK = "tick"
"""Their key for the number of ticks before"""
CURVE = "file of "
"""What a key begins with whose value is the content of a file that a parameter names"""
NOT_OF_THE_RESULT = ("record.", "rerun.", "autostart", "deadline")
"""Parameters (beginnings of their names) of which no answer depends"""


class Change(NamedTuple):
    """What happened to a running node between two ticks."""

    tick: int
    """Ticks in the recording before"""
    values: dict[str, Any] | None
    """Parameters that have changed; None: it was reset"""


class Provenance(NamedTuple):
    """How a recording came about, as it says itself."""

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
        UsageError: it says so, but with parameters that this version does not know; or it is a recording's later part.
    """
    records = list(_metadata(bag))
    found = next((values for name, values in records if name == PROVENANCE), None)
    if found is None:
        part = next((values for name, values in records if name == CONTINUED), None)
        if part is not None:
            first = part.get("first", "another file")
            raise UsageError(
                f"{bag} goes on with {first}, which has the parameters: give the whole folder, or --params"
            )
        return None
    try:
        before = int(found["ticks_before"])
        changes = (change._replace(tick=change.tick - before) for change in _changes(records))
        return Provenance(
            found["package"], found["model_sha256"], load_parameters(json.loads(found["parameters"])),
            {key.removeprefix(CURVE): text for key, text in found.items() if key.startswith(CURVE)},
            before, tuple(sorted(changes, key=lambda change: change.tick)),
        )  # fmt: skip
    except (KeyError, ValueError):  # somebody else's record of the same name
        return None


def with_values(provenance: Provenance, values: Mapping[str, Any]) -> Provenance:
    """The same with other values of some parameters, by dotted names.

    Raises:
        UsageError: an unknown name, a wrong type or a value outside its range.
    """
    curves = {name: text for name, text in provenance.curves.items() if name not in values}
    return provenance._replace(
        parameters=load_parameters(flat_parameters(provenance.parameters) | dict(values)), curves=curves
    )


def model_digest() -> str:
    """SHA-256 of the model's source."""
    return _digest(Path(knee_contact_ros.core.__file__).parent.rglob("*.py"))


def bag_digest(bag: Path) -> str:
    """SHA-256 of a bag: of its file, or of the files that its folder's metadata lists."""
    if bag.is_dir():
        return _digest(path for path in files_of(bag) if path.is_file())
    with bag.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def _digest(paths: Iterable[Path]) -> str:
    """Of files' names and contents, in the order of their names."""
    digest = hashlib.sha256()
    for path in sorted(paths):
        with path.open("rb") as file:
            digest.update(f"{path.name} {hashlib.file_digest(file, 'sha256').hexdigest()}\n".encode())
    return digest.hexdigest()


def _changes(records: Iterable[tuple[str, dict[str, str]]]) -> Iterator[Change]:
    for name, values in records:
        if name == RESET:
            yield Change(int(values[TICK]), None)
        elif name == PARAMETERS_CHANGED:
            changed = {key: json.loads(value) for key, value in values.items() if key != TICK}
            yield Change(int(values[TICK]), changed)


def _metadata(bag: Path) -> Iterator[tuple[str, dict[str, str]]]:
    """Names and contents of the metadata records of a bag's MCAP files; none of those that cannot be read."""
    for path in files_of(bag):
        try:
            with path.open("rb") as file:
                found = list(make_reader(file).iter_metadata())
        except (McapError, OSError, ValueError, EOFError, struct.error):
            found = _in_damaged(path)
        yield from ((record.name, record.metadata) for record in found)


def _in_damaged(path: Path) -> list[Metadata]:
    """What is left of the metadata in a file that is damaged or was cut off, if it is of the kind."""
    try:
        file = open_file(path)
    except OSError:
        return []
    if file is None:
        return []
    with closing(file):
        return list(file.metadata()) if isinstance(file, McapFile) else []
