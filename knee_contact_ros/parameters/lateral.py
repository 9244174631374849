"""The lateral compartment: its parameters are those of the medial one, but for what `lateral.*` says."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

from knee_contact_ros.messages.topics import is_lateral
from knee_contact_ros.parameters.compartments import BOTH
from knee_contact_ros.parameters.schema import Parameters

LATERAL = "lateral."
"""What the names of its parameters begin with"""


def has_both(parameters: Parameters) -> bool:
    """Whether medial and lateral contact are computed."""
    return parameters.load.compartment == BOTH


def lateral_knee(parameters: Parameters) -> Parameters:
    """The parameters of the lateral compartment, under the names that the medial one's have."""
    own = parameters.lateral
    return parameters.model_copy(update={"femur": own.femur, "tibia": own.tibia, "contact": own.contact})


def lateral_texts(texts: Mapping[str, str]) -> dict[str, str]:
    """The contents of its files, of those of both by parameter, under the names that the medial one's have."""
    own = {name.removeprefix(LATERAL): text for name, text in texts.items() if name.startswith(LATERAL)}
    shared = {name: text for name, text in texts.items() if name.startswith("translation.")}
    return shared | own


def answering(topic: str, parameters: Parameters, texts: Mapping[str, str]) -> tuple[Parameters, Mapping[str, str]]:
    """Parameters, and contents of files by parameter, of the compartment whose answers are on a topic."""
    if is_lateral(topic):
        return lateral_knee(parameters), lateral_texts(texts)
    return parameters, texts


def own_and_rest(known: Iterable[str]) -> list[str]:
    """Names of parameters for a person, the lateral ones, which are those of the medial compartment again, as one."""
    return [name for name in known if not name.startswith(LATERAL)] + [f"{LATERAL}* (as of femur, tibia and contact)"]


def with_medial_values(values: Mapping[str, Any], known: Iterable[str]) -> dict[str, Any]:
    """Dotted values and, for each of the `known` lateral ones that is not among them, the medial compartment's."""
    following = {
        name: values[name.removeprefix(LATERAL)]
        for name in known
        if name.startswith(LATERAL) and name not in values and name.removeprefix(LATERAL) in values
    }
    return {**values, **following}


def without_medial_values(values: Mapping[str, Any]) -> dict[str, Any]:
    """Dotted values without the lateral ones that are the medial compartment's: those follow it."""
    return {
        name: value
        for name, value in values.items()
        if not name.startswith(LATERAL) or value != values[name.removeprefix(LATERAL)]
    }
