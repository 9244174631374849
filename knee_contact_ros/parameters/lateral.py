"""Parameters of the lateral compartment: those of the medial one, except where `lateral.*` differs."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

from knee_contact_ros.parameters.compartments import BOTH
from knee_contact_ros.parameters.schema import Parameters

LATERAL = "lateral."
"""Beginning of the names of its parameters"""


def has_both(parameters: Parameters) -> bool:
    """Whether medial and lateral contact are computed."""
    return parameters.load.compartment == BOTH


def lateral_knee(parameters: Parameters) -> Parameters:
    """Parameters of the lateral compartment, under the names of the medial one's."""
    own = parameters.lateral
    return parameters.model_copy(update={"femur": own.femur, "tibia": own.tibia, "contact": own.contact})


def lateral_texts(texts: Mapping[str, str]) -> dict[str, str]:
    """Contents of the lateral compartment's files, under the names of the medial one's parameters.

    `texts` has the contents of the files of both compartments by parameter.
    """
    own = {name.removeprefix(LATERAL): text for name, text in texts.items() if name.startswith(LATERAL)}
    shared = {name: text for name, text in texts.items() if name.startswith("translation.")}
    return shared | own


def own_and_rest(known: Iterable[str]) -> list[str]:
    """Names of parameters for a person; the lateral ones, which repeat the medial ones, as one entry."""
    return [name for name in known if not name.startswith(LATERAL)] + [f"{LATERAL}* (as of femur, tibia and contact)"]


def with_medial_values(values: Mapping[str, Any], known: Iterable[str]) -> dict[str, Any]:
    """Dotted values, and for each lateral one of the `known` names that is missing the medial compartment's value."""
    following = {
        name: values[name.removeprefix(LATERAL)]
        for name in known
        if name.startswith(LATERAL) and name not in values and name.removeprefix(LATERAL) in values
    }
    return {**values, **following}


def without_medial_values(values: Mapping[str, Any]) -> dict[str, Any]:
    """Dotted values without the lateral ones that equal the medial compartment's."""
    return {
        name: value
        for name, value in values.items()
        if not name.startswith(LATERAL) or value != values[name.removeprefix(LATERAL)]
    }
