"""What a comparison changes, which is the contact law and nothing else, and the texts that describe it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from knee_contact_ros.bags.provenance import NOT_OF_THE_RESULT
from knee_contact_ros.parameters.build import material_stiffness
from knee_contact_ros.parameters.files import (
    all_values,
    flat_parameters,
    known_parameters,
    load_parameters,
    values_set_in,
)
from knee_contact_ros.parameters.schema import LATERAL, ContactParameters, Parameters, constants_of
from knee_contact_ros.system.errors import UsageError
from knee_contact_ros.system.files import parameter_file, refuse_twice

SECTION = "contact."
LAW = "law"
NONE, NOT_TOLD = "–", "not told"
"""Texts for a constant that a law does not have, and for a value that is unknown as a recording has no parameters"""
NAMED = 2
"""Number of constants in the name of a curve; all of them are listed below the figure"""


class Difference(NamedTuple):
    """Parameter of the contact law that differs between a run and its comparison."""

    name: str
    """Name of the parameter, without its section"""
    before: Any
    """Value in the run; None: its law has no such constant"""
    after: Any
    """Value in the comparison; None: its law has no such constant"""

    def __str__(self) -> str:
        """Text of the difference, as it stands below a figure: `damping: 5000 → 0 N s/m`."""
        texts = (NONE if value is None else short(value) for value in (self.before, self.after))
        return f"{self.name}: {' → '.join(texts)}{unit(SECTION + self.name)}"


class Overlay(NamedTuple):
    """Parameter values in the files of a comparison, by dotted names."""

    taken: dict[str, Any]
    """Parameters of the contact law, which the comparison uses"""
    left: dict[str, Any]
    """Parameters of the person, the surfaces and the solver, which it does not use: each run keeps its own"""


def overlay(files: Sequence[Path]) -> Overlay:
    """Read the parameter files of a comparison; of values that several set, the last one is taken.

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
    """Combine a run's parameters with the contact law of a comparison."""
    return load_parameters([parameters, over.taken])


def kept(parameters: Parameters, over: Overlay) -> list[str]:
    """List the values that a run keeps although the comparison's files have others: `body_weight 931.6 (not 737)`."""
    own = all_values(parameters)
    return [
        f"{name} {short(own[name])} (not {short(value)})" for name, value in over.left.items() if own[name] != value
    ]


def differences(before: Parameters | None, after: Parameters) -> list[Difference]:
    """Differences of two contact laws in the law itself and the constants that each uses; `before` may be unknown."""
    other = used(after.contact)
    one = used(before.contact) if before else dict.fromkeys(other, NOT_TOLD)
    return [
        Difference(name, one.get(name), other.get(name))
        for name in {**one, **other}
        if one.get(name) != other.get(name)
    ]


def used(contact: ContactParameters) -> dict[str, Any]:
    """Parameters that a contact law uses, by name, with the stiffness that results where the material determines it."""
    computed: Mapping[str, Any] = material_stiffness(contact) if contact.stiffness_from == "material" else {}
    constants = {name: computed.get(name, getattr(contact, name)) for name in constants_of(contact.law)}
    return {LAW: contact.law, **constants, "allow_tension": contact.allow_tension}


def named(differing: Sequence[Difference], *, after: bool) -> str:
    """Name of a curve by what differs: its law, or the constants of a law that both have; empty if nothing differs."""
    values = {each.name: each.after if after else each.before for each in differing}
    if LAW in values:
        return str(values[LAW])
    first = [f"{name} {short(value)}{unit(SECTION + name)}" for name, value in list(values.items())[:NAMED]]
    return ", ".join([*first, "…"] if len(values) > NAMED else first)


def short(value: Any) -> str:
    """Text of a parameter's value, with six significant digits."""
    if isinstance(value, bool):
        return "yes" if value else "no"
    return f"{value:.6g}" if isinstance(value, float) else str(value)


def unit(name: str) -> str:
    """Unit of a parameter behind a space, taken from its description; empty if it has none."""
    meaning = known_parameters()[name].description
    return f" {meaning[1 : meaning.index(']')].replace('exponent', 'n')}" if meaning.startswith("[") else ""


def between(several: Sequence[Parameters]) -> list[str]:
    """Differences of the parameters of several runs, a line for each name: `body_weight: 737.068, 931.6`.

    A lateral compartment is a run of its own, with its parameters under the names of the medial one's.
    """
    left_out = (SECTION, LATERAL, *NOT_OF_THE_RESULT)  # a lateral run has its parameters under the medial one's names
    others = [{k: v for k, v in flat_parameters(each).items() if not k.startswith(left_out)} for each in several]
    laws = [{SECTION + name: value for name, value in used(each.contact).items()} for each in several]
    names = [*dict.fromkeys(name for values in (*others[:1], *laws) for name in values)]
    rows = {name: [(other | law).get(name) for other, law in zip(others, laws, strict=True)] for name in names}
    return [
        f"{name}: {', '.join(NONE if value in (None, '') else short(value) for value in row)}{unit(name)}"
        for name, row in rows.items()
        if any(value != row[0] for value in row)
    ]
