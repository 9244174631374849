"""What a comparison changes, which is the contact law and nothing else, and how that is told."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from knee_contact_ros.bags.provenance import NOT_OF_THE_RESULT
from knee_contact_ros.parameters.build import material_stiffness
from knee_contact_ros.parameters.lateral import LATERAL
from knee_contact_ros.parameters.reading import (
    all_values,
    flat_parameters,
    known_parameters,
    load_parameters,
    values_set_in,
)
from knee_contact_ros.parameters.schema import ContactParameters, Parameters, constants_of
from knee_contact_ros.system.errors import UsageError
from knee_contact_ros.system.resources import parameter_file, refuse_twice

SECTION = "contact."
LAW = "law"
NONE, NOT_TOLD = "–", "not told"
"""Where a law has no such constant; where a recording does not tell its parameters"""
NAMED = 2
"""Constants that the name of a curve tells; all are told below the figure"""


class Difference(NamedTuple):
    """A number of the contact law that differs."""

    name: str
    """Of the parameter, without its section"""
    before: Any
    """None: the law has no such constant"""
    after: Any

    def __str__(self) -> str:
        """As below a figure: `damping: 5000 → 0 N s/m`."""
        texts = (NONE if value is None else short(value) for value in (self.before, self.after))
        return f"{self.name}: {' → '.join(texts)}{unit(SECTION + self.name)}"


class Overlay(NamedTuple):
    """What is taken of the files of a comparison, and what is not, by dotted names."""

    taken: dict[str, Any]
    """Of the contact law"""
    left: dict[str, Any]
    """Of the person, the surfaces and the solver: each run keeps its own"""


def overlay(files: Sequence[Path]) -> Overlay:
    """What the files of a comparison set; the later one wins.

    Raises:
        UsageError: a file cannot be used, is given twice, or sets nothing of the contact law.
    """
    everything: dict[str, Any] = {}
    refuse_twice(list(map(parameter_file, map(str, files))), "--compare ")
    for path in files:
        values = values_set_in(path)
        if not any(name.startswith(SECTION) for name in values):
            raise UsageError(
                f"--compare {path}: sets no {SECTION}* parameter, and a comparison changes these alone; to compare "
                "something else, solve with each and report both recordings"
            )
        everything |= values
    known = {name: value for name, value in everything.items() if name in known_parameters()}
    taken = {name: value for name, value in known.items() if name.startswith(SECTION)}
    left = {name: value for name, value in known.items() if not name.startswith((SECTION, *NOT_OF_THE_RESULT))}
    return Overlay(taken, left)


def compared(parameters: Parameters, over: Overlay) -> Parameters:
    """A run's parameters with another contact law."""
    return load_parameters([parameters, over.taken])


def kept(parameters: Parameters, over: Overlay) -> list[str]:
    """What a run keeps although the files of its comparison say something else: `body_weight 931.6 (not 737.068)`."""
    own = all_values(parameters)
    return [
        f"{name} {short(own[name])} (not {short(value)})" for name, value in over.left.items() if own[name] != value
    ]


def differences(before: Parameters | None, after: Parameters) -> list[Difference]:
    """What two contact laws differ in, of what each uses; the law itself first. The one before may not be known."""
    other = used(after.contact)
    one = used(before.contact) if before else dict.fromkeys(other, NOT_TOLD)
    return [
        Difference(name, one.get(name), other.get(name))
        for name in {**one, **other}
        if one.get(name) != other.get(name)
    ]


def used(contact: ContactParameters) -> dict[str, Any]:
    """What a contact law takes of its parameters; a stiffness from the material is the one that comes out."""
    computed: Mapping[str, Any] = material_stiffness(contact) if contact.stiffness_from == "material" else {}
    constants = {name: computed.get(name, getattr(contact, name)) for name in constants_of(contact.law)}
    return {LAW: contact.law, **constants, "allow_tension": contact.allow_tension}


def named(found: Sequence[Difference], *, after: bool) -> str:
    """A curve's name by what differs: its law, or the constants of a law that both have; empty if nothing does."""
    values = {each.name: each.after if after else each.before for each in found}
    if LAW in values:
        return str(values[LAW])
    first = [f"{name} {short(value)}{unit(SECTION + name)}" for name, value in list(values.items())[:NAMED]]
    return ", ".join([*first, "…"] if len(values) > NAMED else first)


def short(value: Any) -> str:
    """A value as texts show it."""
    if isinstance(value, bool):
        return "yes" if value else "no"
    return f"{value:.6g}" if isinstance(value, float) else str(value)


def unit(name: str) -> str:
    """The unit of a parameter behind a space, as its description tells; empty if it has none."""
    meaning = known_parameters()[name].description
    return f" {meaning[1 : meaning.index(']')].replace('exponent', 'n')}" if meaning.startswith("[") else ""


def between(several: Sequence[Parameters]) -> list[str]:
    """What the parameters of several runs differ in, name by name: `body_weight: 737.068, 931.6`.

    A lateral compartment is a run of its own, with its parameters under the names of the medial one's.
    """
    values = [
        {name: value for name, value in flat_parameters(each).items() if not name.startswith(SECTION)}
        | _constants(each)
        for each in several
    ]
    if not several:
        return []
    left_out = (SECTION, LATERAL, *NOT_OF_THE_RESULT)  # a lateral run has its parameters under the medial one's names
    names = [name for name in values[0] if not name.startswith(left_out)]
    names += list(dict.fromkeys(name for each in several for name in _constants(each)))
    told = ((name, [each.get(name) for each in values]) for name in names)
    return [
        f"{name}: {', '.join(NONE if value in (None, '') else short(value) for value in each)}{unit(name)}"
        for name, each in told
        if any(value != each[0] for value in each)
    ]


def _constants(parameters: Parameters) -> dict[str, Any]:
    """What the contact law uses, by dotted names."""
    return {SECTION + name: value for name, value in used(parameters.contact).items()}
