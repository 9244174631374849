"""`knee_contact_ros.estimate_load`: the command `estimate-load` as a function of Python."""

from __future__ import annotations

import warnings
from collections.abc import Mapping
from os import PathLike
from pathlib import Path
from typing import Any, get_type_hints

import numpy as np
from numpy.typing import NDArray

from knee_contact_ros.bags.bag_files import in_a_line, others_beside
from knee_contact_ros.bags.topic_names import names_in_bag
from knee_contact_ros.joint_reaction.estimator import Estimate
from knee_contact_ros.offline.estimate_load import estimate_load as estimate
from knee_contact_ros.offline.in_memory import check_mappings, in_python, in_python_words
from knee_contact_ros.parameters.files import dotted, load_parameters
from knee_contact_ros.parameters.schema import LoadParameters
from knee_contact_ros.streams.topics import LOAD_INPUTS
from knee_contact_ros.system.files import expanded
from knee_contact_ros.system.output_files import checked_output
from knee_contact_ros.system.terminal import progress

Name = str | PathLike[str]
DTYPE = np.dtype([("stamp", np.int64), *((name, kind) for name, kind in get_type_hints(Estimate).items())])
"""Data type of the rows of the result"""


def estimate_load(
    bag: Name,
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
        bag: An .mcap file, a .db3 file or a rosbag2 folder, with joint_states and ground_reaction_force.
        params: A parameter file of the node knee_load, a mapping, or a list of these; None: the defaults.
        values: Single parameters, which win over all others: `{"person.mass": 70.0}`.
        output: A bag to write as well, from which `solve` can be run.
        overwrite: Replace `output` if it exists.
        remap: Other names of the inputs in the bag: `{"joint_states": "/exo/joint_states"}`.
        namespace: Take the inputs from /NAMESPACE/... of the bag.

    Returns:
        A structured array, shape (n,): `stamp` [ns], and the fields of `LoadEstimate` under their names, in its units.

    Raises:
        UsageError: bag, parameters or output cannot be used, or nothing could be estimated.
    """
    path = expanded(str(bag))
    with in_python_words():
        check_mappings(values, remap)
        sources = params if isinstance(params, (list, tuple)) else [] if params is None else [params]
        parameters = load_parameters([*sources, dotted(values or {})], LoadParameters)
        rules = [f"{ours}:={theirs}" for ours, theirs in (remap or {}).items()]
        names = names_in_bag(rules, namespace, LOAD_INPUTS)
        written = checked_output(Path(output), "output", ".mcap") if output else None
        rows: list[tuple[Any, ...]] = []
        with progress("Estimating") as advance:
            summary = estimate(
                path, parameters, written, advance, overwrite, names, lambda stamp, each: rows.append((stamp, *each))
            )
        doubts = others_beside(path)
        if summary.damage:
            doubts = [*doubts, f"bag {path} is damaged, and read as far as it can be: {in_a_line(summary.damage)}"]
        for sentence in doubts:
            warnings.warn(in_python(sentence), stacklevel=2)
    return np.array(rows, DTYPE)
