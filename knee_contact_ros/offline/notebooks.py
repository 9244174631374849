"""Functions for Python: the commands `solve` and `estimate-load` with arrays."""

import math
import re
import warnings
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from os import PathLike
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..bags.bag import Bag
from ..bags.folder import others_beside
from ..bags.names import Names, names_in_bag
from ..bags.provenance import Provenance
from ..bags.recorder import BagWriter
from ..model.arrays import InputError, plain_array
from ..model.knee import KneeModel
from ..model.types import ROW, Rows
from ..parameters.files import (
    ParameterSource,
    dotted,
    flat_parameters,
)
from ..parameters.schema import Parameters
from ..parameters.subjects import Subject
from ..results import Records
from ..streams.compartments import compartments_of
from ..streams.messages import (
    JointState,
    WrenchStamped,
    encode_joint_state,
    encode_wrench_stamped,
)
from ..streams.topics import JOINT_STATES, LOAD_INPUTS, MESSAGE_TYPES, NANOSECONDS, NET_LOAD
from ..system.arguments import checked
from ..system.errors import UsageError, join_faults, list_names
from ..system.files import expand_user
from ..system.output_files import check_output
from ..system.progress import progress
from .bag_parameters import (
    basis_of,
    file_contents,
    resolved_parameters,
    weight_doubt,
)
from .estimate_load import estimate_load as estimate
from .estimate_load import load_parameters_for
from .gait import Gait
from .solve import solve as solve_bag
from .solve_blocks import AnswerBlock
from .summary import Summary

Name = str | PathLike[str]
ARGUMENTS = (
    (r"--remap '?([\w/~]+):=([\w/~]+)'?", r"remap={'\1': '\2'}"),
    (r"--namespace '?([\w/]+)'?", r"namespace='\1'"),
    (r"-p ([\w.]+):=(\w+)", r"values={'\1': '\2'}"),
    (r"--overwrite\b", "overwrite=True"),
    (r"--(params|remap|namespace|subject|free|sigma)\b", r"\1"),
)
"""Options in a command's messages, as regular expressions, and the Python arguments that replace them"""


@checked
def solve(
    bag: Name | None = None,
    params: ParameterSource | None = None,
    values: Mapping[str, Any] | None = None,
    *,
    subject: Name | None = None,
    output: Name | None = None,
    overwrite: bool = False,
    remap: Mapping[str, str] | None = None,
    namespace: str = "",
    compiled: bool | None = None,
) -> Gait:
    """Compute a recorded gait with the same bits as `knee-contact solve`. Needs no ROS.

    With `load.compartment: both`, the results are those of the medial compartment, and their attribute `lateral` has
    the other's.

    Args:
        bag: An .mcap file, a .db3 file or a rosbag2 folder; None: the one that `subject` names.
        params: As for `load_model`. None: those in a recording of this package, else the healthy knee.
        values: Single parameters, which override all others: `{"contact.damping": 0.0}`.
        subject: A subject file; `params` overrides it.
        output: A recording to write as well.
        overwrite: Replace `output` if it exists.
        remap: Other names of the inputs in the bag: `{"joint_states": "/exo/joint_states"}`.
        namespace: Namespace of the inputs in the bag, and of the node whose sections of parameter files are used.
        compiled: As for `load_model`.

    Implausible parameters or answers, and unreadable parts of a damaged bag, cause warnings.

    Raises:
        UsageError: bag, parameters or output cannot be used, or no tick could be computed.

    Example:
        >>> from knee_contact_ros import solve
        >>> gait = solve("bags/gait2354_right")
        >>> print(len(gait), f"{gait.contact_force.max():.0f} N, {1e3 * gait.penetration_depth.max():.2f} mm")
        387 1614 N, 0.75 mm
    """
    with in_python_words():
        inputs = solve_inputs(bag, params, values, subject, remap, namespace)
        with inputs as (opened, basis, names):
            written = check_output(Path(output), "output", ".mcap") if output else None
            results, summary = answers_of(opened, basis, names, written, overwrite, compiled)
            doubts = weight_doubt(opened, resolved_parameters(basis))
        doubts += [*summary.warnings, summary.unanswered]
        warn_of(opened.path, "solved", doubts, summary.damage)
    return results


def answers_of(
    bag: Bag,
    basis: Parameters | Provenance,
    names: Names,
    output: Path | None = None,
    overwrite: bool = False,
    compiled: bool | None = None,
) -> tuple[Gait, Summary]:
    """Compute a bag as `knee-contact solve` does; return the answers with their models, and the summary."""
    blocks: list[AnswerBlock] = []
    with progress("Solving") as advance:
        summary = solve_bag(
            bag, basis, output, advance, overwrite, names, compiled=compiled, keep=blocks.append
        )
    medial, *lateral = (
        _joined(rows) for rows in zip(*[block.rows for block in blocks], strict=True)
    )
    if lateral:
        medial.lateral = lateral[0]
    for results, model in zip((medial, *lateral), _models(basis), strict=False):
        results.model = model
        results.parameters = flat_parameters(resolved_parameters(basis))
        results.gait_events = bag.gait_events
    return medial, summary


def warn_of(bag: Path, done: str, doubts: Sequence[str], damage: Sequence[str]) -> None:
    """Warn of doubts, if they are not empty, of other recordings in the bag's folder, and of its damage."""
    sentences = [*others_beside(bag), *doubts]
    if damage:
        possible = "it can be read" if done == "solved" else "it can be"
        sentences.append(
            f"bag {bag} is damaged, and {done} as far as {possible}: {join_faults(damage)}"
        )
    for sentence in filter(None, sentences):
        warnings.warn(in_python(sentence), stacklevel=4)  # with `checked`


def _models(basis: Parameters | Provenance) -> list[KneeModel]:
    """Build the model of each compartment; none if the parameters of a recording changed while it was made."""
    if isinstance(basis, Provenance) and basis.changes:
        return []
    return [
        compartment.model
        for compartment in compartments_of(resolved_parameters(basis), file_contents(basis))
    ]


@contextmanager
def solve_inputs(
    bag: Name | None,
    params: ParameterSource | None,
    values: Mapping[str, Any] | None,
    subject: Name | None,
    remap: Mapping[str, str] | None,
    namespace: str,
) -> Iterator[tuple[Bag, Parameters | Provenance, Names]]:
    """Check arguments of `solve`; yield the open bag, what it is computed with, and the names of the inputs in it.

    Raises:
        UsageError: an argument cannot be used.
    """
    person = Subject(expand_user(str(subject))) if subject else None
    path = expand_user(str(bag)) if bag else person.bag if person else None
    if path is None:
        raise UsageError("no bag: give one, or a subject file that names one")
    with Bag(path) as opened:
        basis = basis_of(opened, params, dotted(values or {}), person, namespace)
        yield opened, basis, names_in_bag(remap_rules(remap), namespace)


def remap_rules(remap: Mapping[str, str] | None) -> list[str]:
    """Return rules `FROM:=TO` as on the command line."""
    return [f"{ours}:={theirs}" for ours, theirs in (remap or {}).items()]


def _joined(blocks: Sequence[Rows]) -> Gait:
    """Join blocks of answers to one array."""
    whole = bytearray().join(
        rows.tobytes() for rows in blocks
    )  # NumPy would not copy what is between the fields
    return np.frombuffer(whole, ROW).view(Gait)


@contextmanager
def in_python_words() -> Iterator[None]:
    """Make errors name arguments of Python instead of options of the command; see `in_python`."""
    try:
        yield
    except UsageError as error:
        raise UsageError(in_python(str(error))) from None


def in_python(message: str) -> str:
    """Replace the options in a message of a command by the arguments of its function in Python."""
    for option, argument in ARGUMENTS:
        message = re.sub(option, argument, message)
    return message


NET_ARRAYS = ("time", "knee", "net_force", "net_moment")
"""Names of the arrays that `estimate_load` takes in place of a bag"""


@contextmanager
def _bag_of(bag: Name | Mapping[str, ArrayLike]) -> Iterator[Path]:
    """Yield the path of a bag: the given one, or a temporary one with a net load given as arrays.

    Raises:
        InputError: an array is missing or cannot be used.
    """
    if not isinstance(bag, Mapping):
        yield expand_user(str(bag))
        return
    if set(bag) != set(NET_ARRAYS):
        raise InputError(
            f"arrays {list_names([*map(str, bag)])}: needed are {', '.join(NET_ARRAYS)}"
        )
    columns = [plain_array(name, bag[name]) for name in NET_ARRAYS]
    if len({len(column) for column in columns}) > 1 or not np.isfinite(columns).all():
        raise InputError(f"{', '.join(NET_ARRAYS)} must be of equal length, and finite")
    with TemporaryDirectory() as folder:
        path = Path(folder, "arrays.mcap")
        with BagWriter(path) as writer:
            for topic in (JOINT_STATES, NET_LOAD):
                writer.add_topic(f"/{topic}", MESSAGE_TYPES[topic])
            for time, angle, force, moment in zip(*(c.tolist() for c in columns), strict=True):
                stamp = round(time * NANOSECONDS)
                state = JointState(stamp, "", ("knee",), (angle,), (), ())
                wrench = WrenchStamped(stamp, "tibia", (0.0, -force, 0.0), (math.nan, 0.0, moment))
                writer.write_message(f"/{JOINT_STATES}", stamp, encode_joint_state(state))
                writer.write_message(f"/{NET_LOAD}", stamp, encode_wrench_stamped(wrench))
        yield path


@checked
def estimate_load(
    bag: Name | Mapping[str, ArrayLike],
    params: Any = None,
    values: Mapping[str, Any] | None = None,
    *,
    output: Name | None = None,
    overwrite: bool = False,
    remap: Mapping[str, str] | None = None,
    namespace: str = "",
) -> NDArray[Any]:
    """Estimate the joint reaction force of a bag, as `knee-contact estimate-load` does: the same numbers. Needs no ROS.

    Args:
        bag: An .mcap file, a .db3 file or a rosbag2 folder, with joint_states and ground_reaction_force. Or arrays of
            shape (n,) of inverse dynamics: `time` [s], `knee` [rad], `net_force` [N], positive in compression, and
            `net_moment` [N m], positive in extension.
        params: A parameter file of the node knee_load, a mapping, or a list of these; None: those of a recording
            of estimates, else the defaults.
        values: Single parameters, which override all others: `{"person.mass": 70.0}`.
        output: A bag to write as well, from which `solve` can be run.
        overwrite: Replace `output` if it exists.
        remap: Other names of the inputs in the bag: `{"joint_states": "/exo/joint_states"}`.
        namespace: Namespace of the inputs in the bag, and of the node whose sections of parameter files are used.

    Returns:
        A structured array, shape (n,): `stamp` [ns], and the fields of `LoadEstimate` under their names, in its units.

    Raises:
        UsageError: bag, parameters or output cannot be used, or nothing could be estimated.

    Example:
        >>> from knee_contact_ros import estimate_load
        >>> loads = estimate_load("bags/gait2354_right_sensors", "load/gait2354")
        >>> print(len(loads), f"{loads['axial_force'].max():.0f} N")
        387 1595 N
    """
    with in_python_words(), _bag_of(bag) as path:
        sources = (
            params if isinstance(params, (list, tuple)) else [] if params is None else [params]
        )
        if isinstance(bag, Mapping):
            sources = [f"load/{NET_LOAD}", *sources]
        with Bag(path) as opened:
            parameters, _, changed = load_parameters_for(
                opened, sources, dotted(values or {}), namespace
            )
            names = names_in_bag(remap_rules(remap), namespace, LOAD_INPUTS)
            written = check_output(Path(output), "output", ".mcap") if output else None
            with progress("Estimating") as advance:
                summary = estimate(opened, parameters, written, advance, overwrite, names)
        warn_of(path, "read", [*changed, *summary.implausible], summary.damage)
    return summary.estimates.view(Records)
