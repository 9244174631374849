"""The parameters that a bag is computed with: given ones, those of a recording, or those of a person's subject file."""

from collections.abc import Mapping, Sequence
from operator import attrgetter
from typing import Any

from ..bags.bag import Bag
from ..bags.provenance import Provenance, read_provenance, with_values
from ..joint_reaction.leg import GRAVITY
from ..parameters.curves import curve_texts
from ..parameters.files import (
    SAME_WEIGHT,
    ParameterSource,
    dotted,
    load_parameters,
    own_names,
)
from ..parameters.load_schema import LoadParameters
from ..parameters.schema import Parameters, constants_of
from ..parameters.subjects import Subject
from ..system.errors import UsageError
from ..system.files import DEFAULT_PARAMETERS


def resolved_parameters(basis: Parameters | Provenance) -> Parameters:
    """Return the parameters that a bag is computed with: given ones, or those of a recording."""
    return basis.parameters if isinstance(basis, Provenance) else basis


def file_contents(basis: Parameters | Provenance) -> Mapping[str, str]:
    """Return the contents of the files that parameters name, by parameter.

    Raises:
        UsageError: a file cannot be read, or its contents are not in the recording.
    """
    return basis.file_contents() if isinstance(basis, Provenance) else curve_texts(basis, {})


def basis_of(
    bag: Bag,
    params: ParameterSource | None,
    values: Mapping[str, Any],
    person: Subject | None,
    namespace: str = "",
) -> Parameters | Provenance:
    """Return the parameters to compute a bag with: the given ones, else those in a recording, else the healthy knee.

    `values`, by dotted names, override `params`, and `params` override the subject file of a `person`. Of parameter
    files, the sections for a node in `namespace` are used.

    Raises:
        UsageError: parameters or the recording cannot be used; see `load_parameters` and `read_provenance`.
    """
    stored = read_provenance(bag) if params is None and person is None else None
    if stored:
        return with_values(stored, values)
    if params is None:
        params = () if person else DEFAULT_PARAMETERS
    given = params if isinstance(params, Sequence) and not isinstance(params, str) else [params]
    sources = [*([person.path] if person else ()), *given, values]
    parameters: Parameters = parameters_for(bag, sources, namespace)
    if person and person.content.thickness is not None:
        law = parameters.contact.law
        if "layer_depth" not in constants_of(law):
            raise UsageError(
                f"subject file {person.path}: thickness: {person.content.thickness:g} is not used "
                f"by contact.law {law}"
            )
    return parameters


def parameters_for(
    bag: Bag, sources: Sequence[Any], namespace: str = "", schema: Any = Parameters
) -> Any:
    """Load parameters for a bag: the body weight that it was imported with is used, unless the sources set another one.

    Raises:
        UsageError: as for `load_parameters`.
    """
    return with_body_weight(sources, bag.body_weight, namespace, schema)


def with_body_weight(
    sources: Sequence[Any], weight: float | None, namespace: str = "", schema: Any = Parameters
) -> Any:
    """Load parameters for a body weight [N], unless the sources set another one; see `parameters_for`."""
    parameters = load_parameters(list(sources), schema, namespace)
    if weight is None:
        return parameters
    values = {"body_weight": weight}
    if schema is LoadParameters:
        values = {"person.mass": weight * (1.0 / GRAVITY)}
    (name,) = values
    value_of = attrgetter(name)
    is_given = any(
        isinstance(each, Mapping) and name in own_names(dotted(each), schema) for each in sources
    )
    if is_given or value_of(parameters) != value_of(load_parameters([], schema)):
        return parameters
    return load_parameters([*sources, values], schema, namespace)


def unset_person(parameters: Parameters | LoadParameters) -> str:
    """Return a phrase if nobody has set the person's weight or mass, so that the default is used; else it is empty."""
    name = next(iter(parameters.about_person))
    *section, inner = name.split(".")
    part = getattr(parameters, section[0]) if section else parameters
    return "" if inner in part.model_fields_set else f", which nobody has set (-p {name}:=...)"


def weight_row(bag: Bag, parameters: Parameters) -> dict[str, str]:
    """Return a row for a summary that says where the body weight comes from, if the user has not set it."""
    weight, unset = f"{parameters.body_weight:.7g} N", unset_person(parameters)
    if bag.body_weight == parameters.body_weight:
        return {"body weight": f"{weight}, as {bag.path.name} was imported with"}
    return {"body weight": f"{weight}{unset}"} if unset else {}


def weight_doubt(bag: Bag, parameters: Parameters | LoadParameters) -> list[str]:
    """Return a sentence that a bag was imported with another body weight than that of the parameters, in a list."""
    if isinstance(parameters, LoadParameters):
        used = parameters.person.mass * GRAVITY
        given = f"person.mass {used / GRAVITY:.7g} kg"
    else:
        used = parameters.body_weight
        given = f"body_weight {used:.7g} N"
    weight = bag.body_weight
    if weight is None or abs(used - weight) <= SAME_WEIGHT * weight:
        return []
    return [f"{given} is used as you gave it, but bag {bag} was imported with {weight:.7g} N"]
