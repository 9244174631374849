"""Provenance of a recording, stored in it, so that its answers can be computed again from it alone."""

import json
from collections.abc import Iterable, Mapping
from contextlib import suppress
from operator import methodcaller
from pathlib import Path
from typing import Any, NamedTuple

import knee_contact_ros.model

from .. import __version__
from ..parameters.curves import curve_files, read_curve
from ..parameters.files import flat_parameters, load_parameters
from ..parameters.load_schema import LoadParameters
from ..parameters.schema import Parameters
from ..streams.output import (
    ANSWERS_FLAGGED,
    LOAD_PROVENANCE,
    PROVENANCE,
    RESET,
    STATUS,
    TICK,
    WAITING,
    RunState,
)
from ..system.errors import UsageError
from .bag import Bag, opened_bag
from .folder import files_digest
from .recorder import CONTINUED

PARAMETERS_CHANGED = "parameters_changed"
"""Name of the metadata record of changed parameters in a running node"""
TICKS_BEFORE = "ticks_before"
"""Key for the number of ticks that the node had computed before the recording began"""
STATE = "state"
"""Key for the state of the run at the beginning of the recording, as JSON"""
CURVE = "file of "
"""Prefix of the key for the content of a file that a parameter names; the name of the parameter follows"""
OURS = "knee_contact_ros "
"""Prefix of the package's name and version in a record of this package"""
ALL_BITS = 255
"""All bits of a status"""
NOT_OF_THE_RESULT = ("record.", "rerun.", "diagnostics.", "autostart", "realtime", "deadline")
"""Prefixes of the names of parameters that no answer depends on"""


class Change(NamedTuple):
    """Change of parameters, or reset, between two ticks of a running node."""

    tick: int
    """Number of ticks in the recording before the change"""
    values: dict[str, Any] | None
    """Changed parameters by name; None for a reset"""
    waiting: int = 0
    """Number of angles that had come before a reset and belong to later answers"""


class Flags(NamedTuple):
    """Bits of `Status` that all answers have from a tick on, for a reason that no sample shows."""

    tick: int
    """Number of ticks in the recording before"""
    status: int
    """The bits"""


class Provenance(NamedTuple):
    """Provenance of a recording: how its answers were computed."""

    recording: Path
    """Path of the recording"""
    package: str
    """Name and version of the package"""
    model: str
    """SHA-256 of the source of the model"""
    parameters: Parameters
    """Parameters at the beginning of the recording"""
    curves: dict[str, str]
    """Contents of the files that parameters name, by the names of the parameters"""
    ticks_before: int
    """Number of ticks that the node had computed before the recording began"""
    state: RunState | None
    """State of the run after these ticks; None: another version made the recording, or it begins with the run"""
    changes: tuple[Change, ...]
    """Changes of parameters and resets, in the order of the ticks"""
    damage: tuple[str, ...]
    """Unreadable parts of the provenance, as sentences"""

    def file_contents(self) -> dict[str, str]:
        """Return the contents of the files that the model needs, by the names of the parameters. No file is opened.

        Raises:
            UsageError: The recording does not contain one of them.
        """
        names = curve_files(self.parameters)
        for by, name in names.items():
            if by not in self.curves:
                raise UsageError(
                    f"{self.recording} does not hold the file that its parameter {by} names ({name}): give your own "
                    f"with -p {by}:=FILE, or all parameters with --params"
                )
        return {by: self.curves[by] for by in names}


def provenance_record(
    parameters: Parameters | LoadParameters,
    curves: Mapping[str, str] = {},
    source: Bag | None = None,
    ticks_before: int = 0,
    state: RunState | None = None,
) -> dict[str, str]:
    """Return the content of the metadata record; nothing in it depends on where or when it is written.

    Args:
        parameters: Parameters at the beginning of the recording, of answers or of estimated joint reactions.
        curves: Contents of files that parameters name (`curve_texts`).
        source: Bag that the inputs come from, if any.
        ticks_before: Number of ticks that the node had computed before the recording began.
        state: State of the run after these ticks.
    """
    values = {
        name: value
        for name, value in flat_parameters(parameters).items()
        if not name.startswith(NOT_OF_THE_RESULT)
    }
    record = {"package": f"{OURS}{__version__}"}
    if isinstance(parameters, LoadParameters):
        record["level"] = parameters.chosen_level
    else:
        record["model_sha256"] = model_digest()
    record["parameters"] = json.dumps(values, indent=0)
    record |= beginning(ticks_before, state)
    record |= {CURVE + name: text for name, text in curves.items()}
    if source:
        record["source"] = source.path.name
        record["source_sha256"] = source.digest
    return record


def beginning(ticks_before: int, state: RunState | None) -> dict[str, str]:
    """Return the part of the record about a recording that begins after a number of ticks, in a state of the run."""
    record = {TICKS_BEFORE: str(ticks_before)}
    if state:
        record[STATE] = json.dumps(state, default=methodcaller("tolist"))
    return record


def change_record(tick: int, values: Mapping[str, Any]) -> dict[str, str]:
    """Return the content of the metadata record for parameters that have changed to these values after `tick` ticks."""
    return {TICK: str(tick)} | {name: json.dumps(value) for name, value in values.items()}


def read_provenance(bag: Path | Bag) -> Provenance | None:
    """Return the provenance of a bag; None if it contains none.

    Raises:
        UsageError: The provenance is damaged, or has parameters that this version does not know; or the bag is a later
            file of a recording, without its first one; or the bag cannot be opened.
    """
    with opened_bag(bag) as recording:
        path = recording.path
        records = recording.metadata
        record = recording.first_metadata(PROVENANCE)
        continued = recording.first_metadata(CONTINUED)
        is_load = recording.first_metadata(LOAD_PROVENANCE) is not None
    if record is None and continued is not None and not is_load:
        begin = continued.get("first", "another file")
        raise UsageError(
            f"{path} continues {begin}, which holds the parameters: give the whole folder, or --params"
        )
    sets = {tuple(sorted(one.items())) for one in map(_of_result, records) if one}
    if len(sets) > 1:
        raise UsageError(
            f"{path} holds answers that were computed with {len(sets)} sets of parameters: give its recordings one by "
            "one, or --params"
        )
    values = _values_in(path, PROVENANCE, record)
    if record is None or values is None:
        return None
    before = int(record[TICKS_BEFORE])
    changes, damage = _changes(records, before)
    try:
        parameters = load_parameters(values)
    except UsageError as error:
        raise UsageError(f"{path}, in its record {PROVENANCE}: {error}") from None
    return Provenance(
        recording=path,
        package=record["package"],
        model=record.get("model_sha256", ""),
        parameters=parameters,
        curves={
            key.removeprefix(CURVE): text for key, text in record.items() if key.startswith(CURVE)
        },
        ticks_before=before,
        state=_state_in(path, record),
        changes=tuple(changes),
        damage=tuple(damage),
    )


def recorded_flags(recording: Bag, provenance_name: str = PROVENANCE) -> list[Flags]:
    """Return the bits that the node of a recording gave to all later answers, in the order of the ticks."""
    begin = recording.first_metadata(provenance_name)
    flags = list[Flags]()
    for name, content in recording.metadata:
        if begin and name == ANSWERS_FLAGGED:
            with suppress(KeyError, ValueError):  # a damaged record
                tick = int(content[TICK]) - int(begin[TICKS_BEFORE])
                flags.append(Flags(tick, int(content[STATUS]) & ALL_BITS))
    return sorted(flags, key=lambda each: each.tick)


def _of_result(record: tuple[str, Mapping[str, str]]) -> dict[str, str]:
    """Return what answers depend on in a metadata record of our provenance; empty if it is none."""
    name, content = record
    if name != PROVENANCE or not content.get("package", "").startswith(OURS):
        return {}
    files = {key: text for key, text in content.items() if key.startswith(CURVE)}
    return files | {"parameters": content.get("parameters", "")}


def _values_in(bag: Path, name: str, record: Mapping[str, str] | None) -> dict[str, Any] | None:
    """Return the parameters in the record `name` of a bag; None if it has no such record, or only another package's.

    Raises:
        UsageError: The record is damaged.
    """
    if not record or not record.get("package", "").startswith(OURS):
        return None
    try:
        values: dict[str, Any] = dict(json.loads(record["parameters"]))
        if int(record[TICKS_BEFORE]) >= 0 and not any(
            isinstance(value, (dict, list)) for value in values.values()
        ):
            return values
    except (KeyError, TypeError, ValueError, RecursionError):
        pass
    raise UsageError(
        f"{bag}: its record {name}, which has the parameters, is damaged: give --params"
    )


def _state_in(bag: Path, record: Mapping[str, str]) -> RunState | None:
    """Return the state of the run in a record; None if it has none for this version of the model.

    Raises:
        UsageError: The state is damaged.
    """
    if STATE not in record or record.get("model_sha256") != model_digest():
        return None
    try:
        stamp, angles, numbers, *_ = json.loads(record[STATE])
        return RunState(
            None if stamp is None else int(stamp),
            [
                (int(at), float(angle), None if height is None else float(height), int(delay))
                for at, angle, height, delay in angles
            ],
            [list(map(float, each)) for each in numbers],
        )
    except (TypeError, ValueError, RecursionError):
        raise UsageError(f"{bag}: its record {PROVENANCE} has a damaged {STATE}") from None


def stored_load(bag: Bag) -> tuple[dict[str, Any], int] | None:
    """Return the parameters at the beginning of a recording of loads, by name, and how often they changed in it.

    None: the bag is not such a recording.

    Raises:
        UsageError: The record that has the parameters is damaged.
    """
    values = _values_in(bag.path, LOAD_PROVENANCE, bag.first_metadata(LOAD_PROVENANCE))
    if values is None:
        return None
    changes = [content for name, content in bag.metadata if name == PARAMETERS_CHANGED]
    matter = [
        any(name != TICK and not name.startswith(NOT_OF_THE_RESULT) for name in content)
        for content in changes
    ]
    return values, sum(matter)


def with_values(provenance: Provenance, values: Mapping[str, Any]) -> Provenance:
    """Return a provenance with other values of some parameters, by dotted names; files that these name are read.

    Raises:
        UsageError: A name is unknown, a value has a wrong type or is out of range, or a file cannot be read.
    """
    parameters = load_parameters(flat_parameters(provenance.parameters) | dict(values))
    curves = {
        name: read_curve(name, file)
        for name, file in curve_files(parameters).items()
        if name in values
    }
    return provenance._replace(
        parameters=parameters, curves=provenance.curves | curves, state=None
    )


def model_digest() -> str:
    """Return the SHA-256 of the source of the model."""
    return files_digest(Path(knee_contact_ros.model.__file__).parent.rglob("*.py"))


def _changes(
    records: Iterable[tuple[str, dict[str, str]]], before: int
) -> tuple[list[Change], list[str]]:
    """Return the changes in the order of ticks, counted from `before`, and the faults of unreadable records."""
    changes, damage = [], []
    for name, values in records:
        if name not in (RESET, PARAMETERS_CHANGED):
            continue
        try:
            tick = int(values[TICK]) - before
            changed = {key: json.loads(value) for key, value in values.items() if key != TICK}
            waiting = int(changed.get(WAITING, 0))
        except (KeyError, TypeError, ValueError, RecursionError):
            when = f" (tick {values[TICK]})" if values.get(TICK) else ""
            damage.append(f"a record {name}{when} is damaged; its change is not repeated")
            continue
        changes.append(Change(tick, None if name == RESET else changed, waiting))
    return sorted(changes, key=lambda change: change.tick), damage
