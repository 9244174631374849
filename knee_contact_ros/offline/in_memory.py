"""`knee_contact_ros.solve`: what the command of that name computes, for a notebook."""

from __future__ import annotations

import re
import warnings
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np

from knee_contact_ros.bags.bag_files import in_a_line, others_beside
from knee_contact_ros.bags.provenance import Provenance, read_provenance, with_values
from knee_contact_ros.bags.topic_names import Names, names_in_bag
from knee_contact_ros.core.model import KneeModel
from knee_contact_ros.core.types import ROW, Rows
from knee_contact_ros.offline.solve import solve as solve_bag
from knee_contact_ros.parameters.curves import curve_texts
from knee_contact_ros.parameters.reading import Source, dotted, load_parameters
from knee_contact_ros.parameters.schema import Parameters
from knee_contact_ros.parameters.subject import Subject
from knee_contact_ros.pipeline.compartment import compartments_of
from knee_contact_ros.results import Results
from knee_contact_ros.system.errors import UsageError
from knee_contact_ros.system.output_files import checked_output
from knee_contact_ros.system.resources import DEFAULT_PARAMETERS, expanded
from knee_contact_ros.system.terminal import progress

Name = str | PathLike[str]
EXAMPLES = {"values": "{'contact.damping': 0.0}", "remap": "{'joint_states': '/exo/joint_states'}"}
ARGUMENTS = (
    (r"--remap '?([\w/~]+):=([\w/~]+)'?", r"remap={'\1': '\2'}"),
    (r"--namespace '?([\w/]+)'?", r"namespace='\1'"),
    (r"-p ([\w.]+):=(\w+)", r"values={'\1': '\2'}"),
    (r"--overwrite\b", "overwrite=True"),
    (r"--(params|remap|namespace|subject|free|sigma)\b", r"\1"),
)
"""What the command is told, and how it is told in Python"""


def solve(
    bag: Name | None = None,
    params: Source | None = None,
    values: Mapping[str, Any] | None = None,
    *,
    subject: Name | None = None,
    output: Name | None = None,
    overwrite: bool = False,
    remap: Mapping[str, str] | None = None,
    namespace: str = "",
    compiled: bool | None = None,
) -> Results:
    """Compute a recorded gait, as `knee-contact solve` does: the same bits. Needs no ROS.

    With `load.compartment` both, these are the results of the medial compartment, and their `lateral` has the other's.

    Args:
        bag: An .mcap file, a .db3 file or a rosbag2 folder; None: the one that `subject` names.
        params: As for `load_model`. None: the healthy knee; of a recording of ours, the parameters stored in it.
        values: Single parameters, which win over all others: `{"contact.damping": 0.0}`.
        subject: A subject file; `params` wins over it.
        output: Recording to write, too.
        overwrite: Replace `output` if it exists.
        remap: Other names of the inputs in the bag: `{"joint_states": "/exo/joint_states"}`.
        namespace: Take the inputs from /NAMESPACE/... of the bag.
        compiled: As for `load_model`.

    What makes no sense in parameters or answers, and what of a damaged bag cannot be read, is warned of.

    Raises:
        UsageError: bag, parameters or output cannot be used, or no tick could be computed.
    """
    with in_python_words():
        path, how, names = asked_in_python(bag, params, values, subject, remap, namespace)
        written = checked_output(Path(output), "output", ".mcap") if output else None
        blocks: list[Sequence[Rows]] = []
        with progress("Solving") as advance:
            summary = solve_bag(path, how, written, advance, overwrite, names, compiled=compiled, keep=blocks.append)
        doubts = [*others_beside(path), *summary.warnings]
        if summary.damage:
            doubts.append(f"bag {path} is damaged, and solved as far as it can be read: {in_a_line(summary.damage)}")
        for sentence in doubts:
            warnings.warn(in_python(sentence), stacklevel=2)
    medial, *lateral = (_joined(rows) for rows in zip(*blocks, strict=True))
    if lateral:
        medial.lateral = lateral[0]
    for results, model in zip((medial, *lateral), _models(how), strict=False):
        results.model = model
    return medial


def _models(how: Parameters | Provenance) -> list[KneeModel]:
    """Of each compartment; none where a recording's parameters changed, so that no model computed all of it."""
    if isinstance(how, Parameters):
        return [each.model for each in compartments_of(how, curve_texts(how, {}))]
    return [] if how.changes else [each.model for each in compartments_of(how.parameters, how.texts())]


def asked_in_python(
    bag: Name | None,
    params: Source | None,
    values: Mapping[str, Any] | None,
    subject: Name | None,
    remap: Mapping[str, str] | None,
    namespace: str,
) -> tuple[Path, Parameters | Provenance, Names]:
    """Which bag, what to compute it with, and the names of the inputs in it; the arguments are those of `solve`.

    Raises:
        UsageError: one of them cannot be used.
    """
    check_mappings(values, remap)
    person = Subject(expanded(str(subject))) if subject else None
    path = expanded(str(bag)) if bag else person.bag if person else None
    if path is None:
        raise UsageError("no bag: give one, or a subject file that names one")
    how = asked_of(path, params, dotted(values or {}), person)
    return path, how, names_in_bag([f"{ours}:={theirs}" for ours, theirs in (remap or {}).items()], namespace)


def check_mappings(values: object, remap: object) -> None:
    """Refuse arguments of `solve` and `estimate_load` that are no mappings.

    Raises:
        UsageError: one is none.
    """
    for name, mapping in (("values", values), ("remap", remap)):
        if mapping is not None and not isinstance(mapping, Mapping):
            raise UsageError(f"{name}: {mapping!r} is not allowed; a mapping, as {EXAMPLES[name]}")


def _joined(blocks: Sequence[Rows]) -> Results:
    whole = bytearray().join(rows.tobytes() for rows in blocks)  # NumPy would not copy what is between the fields
    return np.frombuffer(whole, ROW).view(Results)


@contextmanager
def in_python_words() -> Iterator[None]:
    """Errors of the command, in Python's words."""
    try:
        yield
    except UsageError as error:
        raise UsageError(in_python(str(error))) from None


def in_python(message: str) -> str:
    """A command's message with its options as arguments of `solve`."""
    for option, argument in ARGUMENTS:
        message = re.sub(option, argument, message)
    return message


def asked_of(
    bag: Path, params: Source | None, values: Mapping[str, Any], person: Subject | None
) -> Parameters | Provenance:
    """What to compute a bag with: as asked, else as a recording says of itself, else the healthy knee.

    `values`, by dotted names, win over `params`, and these over the person's.

    Raises:
        UsageError: see `load_parameters` and `read_provenance`.
    """
    stored = read_provenance(bag) if params is None and person is None else None
    if stored:
        return with_values(stored, values)
    if params is None:
        params = () if person else DEFAULT_PARAMETERS
    given = params if isinstance(params, Sequence) and not isinstance(params, str) else [params]
    return load_parameters([*(person.sources() if person else ()), *given, values])
