"""What a paper cites of a bag: software, model, contact law, surfaces, load, and where the gait comes from."""

import re
import textwrap
from typing import Any

from ..bags.bag import Bag
from ..bags.provenance import OURS, Provenance, read_provenance, stored_load
from ..model.laws import CONTACT_LAWS
from ..parameters.build import law_constants
from ..parameters.curves import SHARE_FILE
from ..parameters.files import known_parameters, load_parameters
from ..parameters.load_schema import LoadParameters
from ..parameters.schema import (
    LATERAL_PREFIX,
    Parameters,
    has_two_compartments,
    lateral_knee,
)
from ..streams.output import LOAD_PROVENANCE, PROVENANCE
from ..system.errors import UsageError

PAPER = (
    "The prediction of knee contact forces with the novel two-dimensional dynamic model of human knee. Acta Mechanica "
    "et Automatica, article 219102, accepted 3 December 2025. "
    "https://www.amajournal.com/The-Prediction-of-Knee-Contact-Forces-with-The-Novel-Two-Dimensional-Dynamic-Model,"
    "219102,0,2.html"
)
"""The paper of the model, as far as this project knows it"""
PAPER_UNKNOWN = (
    "This project knows neither its authors nor its DOI: take them from the journal's page."
)
"""What it does not know of that paper"""
NO_ADDRESS = "This project has no public address: name the place that you have it from."
_LOAD_SOURCES = (
    "body segments: Winter 2009, doi:10.1002/9780470549148; moment arms: Delp et al. 1990, doi:10.1109/10.102791; "
    "activation dynamics: Thelen 2003, doi:10.1115/1.1531112"
)
_MEAN_CURVE = (
    "instrumented knees of Fregly et al. 2012, doi:10.1002/jor.22023, and Modenese et al. 2021, "
    "doi:10.1016/j.gaitpost.2021.06.014"
)
_PARALLEL_MECHANISM = (
    "Sancisi, Gasparutto, Parenti-Castelli & Dumas 2017, doi:10.1007/s11012-016-0532-x"
)
_LONGEST_COMMENT = 900
"""Most characters that are repeated of the comment at the top of a file, or of an entry in a bag"""
_TO_CITE = ("source", "credit", "licence", "force")
"""Entries of the record of an imported bag that a paper needs"""


def citation(bag: Bag) -> dict[str, str]:
    """Return what to cite, as sentences by subject.

    Raises:
        UsageError: nothing in the bag says where it comes from, or its provenance cannot be used.
    """
    parts: dict[str, str] = {}
    if provenance := read_provenance(bag):
        parts |= _of_answers(bag, provenance)
    if load := stored_load(bag):
        values, changes = load
        package = (bag.first_metadata(LOAD_PROVENANCE) or {}).get("package", "")
        parts |= {"software": _software(package), **_of_load(values, changes)}
    if known := [f"{name}: {_short(text)}" for name in _TO_CITE if (text := bag.origin.get(name))]:
        parts["gait"] = "; ".join(known)
    if not parts:
        raise UsageError(
            f"{bag} does not say how it was made: give a recording of {OURS.strip()}, or a bag of one of its importers"
        )
    return parts


def _of_answers(bag: Bag, provenance: Provenance) -> dict[str, str]:
    """Return the parts of a recording with answers."""
    parameters = provenance.parameters
    parts = {
        "software": _software(provenance.package, provenance.model),
        "model": f"{PAPER}. {PAPER_UNKNOWN}",
    }
    knees = {"": parameters}
    if has_two_compartments(parameters):
        knees = {"medial ": parameters, "lateral ": lateral_knee(parameters)}
    for name, knee in knees.items():
        before = LATERAL_PREFIX if knee is not parameters else ""
        parts[f"{name}law"] = law_text(knee)
        parts[f"{name}surfaces"] = "; ".join(
            f"{bone}: {_surface(surface, provenance.curves.get(f'{before}{bone}.profile', ''))}"
            for bone, surface in (("femur", knee.femur), ("tibia", knee.tibia))
        )
    parts["translation"] = _translation(parameters, provenance.curves)
    parts["load"] = _load_rule(parameters, provenance.curves)
    source = (bag.first_metadata(PROVENANCE) or {}).get("source")
    parts["input"] = (
        f"{_short(source)}; run knee-contact cite on it, too"
        if source
        else "as a node heard it; the recording does not say where angle and force came from"
    )
    if provenance.changes:
        changed = dict.fromkeys(name for each in provenance.changes for name in each.values or {})
        parts["changes"] = (
            f"{len(provenance.changes)} changes or resets while it was recorded"
            + f", of {', '.join(changed)}" * bool(changed)
        )
    return parts


def _software(package: str, model: str = "") -> str:
    """Return the name, version and model of the software, and where it is found."""
    digest = f", model {model[:12]} (SHA-256 of its source)" if model else ""
    return f"The knee_contact_ros authors: {_short(package)}{digest}. {NO_ADDRESS}"


def law_text(parameters: Parameters) -> str:
    """Return the contact law with its constants in SI units, and the source that the docstring of its factory names."""
    contact = parameters.contact
    units = known_parameters()
    constants = [
        f"{name} {value:.6g} {units[f'contact.{name}'].unit}".strip()
        for name, value in law_constants(contact).items()
        if not isinstance(value, bool)
    ]
    description = " ".join((CONTACT_LAWS[contact.law].__doc__ or "").split()) + " "
    source = "not named"
    if found := re.search(r"Source: (.+?doi:\S+?)[.,]?\s", description):
        source = found[1]
    elif equation := re.search(r"\((Eqs?\. [\d, ]*\d)", description):
        source = f"the model's paper, {equation[1]}"
    if law_constants(contact).get("damp_first_layer"):
        source += ", with the dashpot in the first layer, too, which the paper has not"
    how = ", stiffness from the material" if contact.stiffness_from == "material" else ""
    pulls = ", pulls where its formula does" if contact.allow_tension else ""
    return f"{contact.law}: {', '.join(constants)}{how}{pulls}. Source: {source}"


def _surface(surface: Any, text: str) -> str:
    """Return what a surface is; of a measured one, what the comment at the top of its file says."""
    if surface.geometry == "profile":
        scale = f", times {surface.scale:g}" if surface.scale != 1.0 else ""
        return f"profile {surface.profile}{scale} ({comment_of(text)})"
    if surface.geometry == "plane":
        return f"plane with a slope of {surface.slope:g} rad"
    return f"{surface.geometry} with a radius of {surface.radius:g} m"


def _translation(parameters: Parameters, curves: Any) -> str:
    """Return the mechanism that moves the femur along the tibia, and its source."""
    mechanism = parameters.translation.mechanism
    if mechanism == "table":
        return f"table {parameters.translation.table} ({comment_of(curves.get('translation.table', ''))})"
    return (
        f"{mechanism} ({_PARALLEL_MECHANISM})" if mechanism == "parallel_mechanism" else mechanism
    )


def _load_rule(parameters: Parameters, curves: Any) -> str:
    """Return which part of the joint reaction loads the compartment, and the body weight."""
    load, weight = parameters.load, f"body weight {parameters.body_weight:.7g} N"
    if parameters.drive == "displacement":
        return f"none: the height of the femur is given; {weight}"
    rule = {
        "total": "the whole axial joint reaction",
        "fixed_share": f"{load.share:g} of the axial joint reaction",
        "moment_balance": f"by the frontal moment, compartments {load.compartment_spacing:g} m apart",
        "measured_share": f"{load.share_file} ({comment_of(curves.get(SHARE_FILE, ''))})",
    }[load.rule]
    return f"{load.rule}: {rule}; {weight}"


def _of_load(values: dict[str, Any], changes: int) -> dict[str, str]:
    """Return the part of estimated joint reactions, from their parameters and how often these changed."""
    parameters: LoadParameters = load_parameters(values, LoadParameters)
    person = parameters.person
    fitted = "fitted" if parameters.calibrated else "not fitted"
    sources = _LOAD_SOURCES
    if person.expected_load:
        sources += (
            f"; mean curve of walking, with a weight of {person.expected_load:g}: {_MEAN_CURVE}"
        )
    text = (
        f"level {parameters.chosen_level}, body mass {person.mass:g} kg, height {person.height:g} m, constants "
        f"{fitted} to this person. Sources: {sources}"
    )
    return {
        "load estimate": text
        + f"; {changes} changes of parameters while it was recorded" * bool(changes)
    }


def comment_of(text: str) -> str:
    """Return the comment at the top of a file's text in one line, shortened; a phrase if it has none."""
    comment = []
    for line in text.splitlines():
        if not line.startswith("#"):
            break
        comment.append(line.lstrip("# "))
    return _short(" ".join(comment)) or "its file does not say where it comes from"


def _short(text: str) -> str:
    """Return a text in one line, shortened."""
    return textwrap.shorten(text, _LONGEST_COMMENT, placeholder=" ...")
