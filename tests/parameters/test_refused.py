"""Names and defaults hold, and what is not allowed is refused in one line that says what is."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

import knee_contact_ros
from knee_contact_ros.parameters.files import check_file, load_parameters
from knee_contact_ros.parameters.schema import LoadParameters, NodeSection, Parameters
from knee_contact_ros.system.errors import UsageError

CIRCLE = {"tibia.geometry": "circle"}
REFUSED: dict[type[NodeSection], list[tuple[dict[str, Any], str]]] = {
    Parameters: [
        ({"contact.damping": -1.0}, r"contact\.damping: -1\.0 is not allowed; it should be greater than or equal to 0"),
        ({"contact.damping": "5000"}, r"contact\.damping: '5000' is not allowed; it should be a valid number"),
        ({"contact.damping": float("nan")}, "nan is not allowed; it should be a finite number"),
        ({"contact.law": "hook"}, r"contact\.law: 'hook' is not allowed; allowed: .*hertz, kelvin_voigt"),
        ({"contact.allow_tension": 1}, "1 is not allowed; it should be a valid boolean"),
        ({"contact.poissons_ratio": 0.5}, "less than 0.5"),
        ({"record.max_size": 0.01}, r"max_size: 0\.01 is not allowed; allowed: 0 \(off\) or a number >= 0\.1"),
        ({"fidelity.force_tolerance": 1e-10}, r"0 \(off\) or a number >= 1e-09"),
        ({"fidelity.budget": 5}, r"0 \(a hundred thousand\) or an integer >= 100"),
        ({"knee.flexion_sign": 2.0}, r"2\.0 is not allowed; allowed: 1\.0, -1\.0"),
        ({"contact.dampin": 1.0}, r"unknown parameter contact\.dampin; did you mean contact\.damping\?"),
        ({"zzz": 1.0}, r"unknown parameter zzz; known are knee\.joint_name.*, lateral\.\* \("),
        ({"femur.geometry": "profile"}, r"femur\.profile is empty"),
        ({"translation.mechanism": "table"}, r"translation\.table is empty"),
        (CIRCLE | {"tibia.slope": 0.1}, r"tibia\.slope: 0\.1 is not allowed; only .* plane"),
        (CIRCLE | {"tibia.radius": 0.034}, r"tibia\.radius: 0\.034 .* exceed femur\.radius, 0\.034"),
        ({"contact.stiffness_from": "material", "contact.exponent": 1.0}, r"contact\.exponent: 1 .* needs 1\.5"),
        ({"contact.law": "elastic_foundation", "contact.tibial_radius": 0.03}, r"tibial_radius: 0\.03 .* 0\.034"),
        ({"femur.scale": 1.1}, r"femur\.scale: 1\.1 is not allowed; only femur\.geometry profile"),
    ],
    LoadParameters: [
        ({"level": "muscles"}, r"level: 'muscles' is not allowed; .*auto, ground_force, knee_moment, ankle_moment"),
        ({"knee.joint_name": ""}, r"knee\.joint_name: '' is not allowed"),
        ({"hip.joint_name": "knee"}, r"parameter knee\.joint_name: knee, knee are not different joints"),
        ({"ankle.assisted": True}, r"ankle\.assisted: True is not allowed; ankle\.joint_name is empty"),
        ({"hip.assisted": True}, r"unknown parameter hip\.assisted"),
        ({"frame.tibia": ""}, r"frame\.tibia: '' is not allowed"),
        ({"frame.ground": "/plate"}, r"frame\.ground: '/plate' is not allowed; .*without a slash before it"),
        ({"person.height": 175.0}, r"person\.height: 175\.0 is not allowed; .*2\.5"),
        ({"standard_deviation": 0.001}, r"standard_deviation: 0\.001 .* 0 \(as measured for the level\) or a num"),
    ],
}
OURS, LOAD = r"\(healthy, .*osteoarthritis.*\)", r"\(load/gait2354, load/insole, load/inverse_dynamics\)"
MISSING: dict[type[NodeSection], list[tuple[Any, str]]] = {
    Parameters: [
        ("nowhere.yaml", r"nowhere\.yaml: cannot read the parameter file"),
        ("osteoarthritic", rf"^osteoarthritic: .* {OURS}; did you mean osteoarthritis\?$"),
        ("xyz", r"own \([^)]*\)$"),
    ],
    LoadParameters: [
        ("inverse_dynamic", rf"{LOAD}; did you mean load/inverse_dynamics\?$"),
        ("load/insol", rf"{LOAD}; did you mean load/insole\?$"),
        ("xyz", rf"the package's own {LOAD}$"),
    ],
}
ALL = [(schema, *each) for table in (REFUSED, MISSING) for schema, cases in table.items() for each in cases]


@pytest.mark.parametrize(("schema", "source", "words"), ALL)
def test_what_is_not_allowed_is_refused_in_one_line(schema: type[NodeSection], source: Any, words: str) -> None:
    with pytest.raises(UsageError, match=words) as caught:
        load_parameters(source, schema)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("content", "words"),
    [
        ("a: [", "not a YAML file"),
        ("- 1", "must map node names"),
        ("other_node:\n  ros__parameters: {x: 1}", "no parameters for node knee_contact; found other_node"),
        ("/**:\n  ros__parameters: {contact: {damping: -1.0}}", "contact.damping"),
        ("\xff", "unknown|map node names|YAML"),
        ("/**:\n  ros__parameters:\n    femur.mass: 8\n    femur: {mass: 9.5}", r"femur\.mass is given twice$"),
        ("/**/knee_contact:\n  ros__parameters: [1]", r"ros__parameters must map names to values, got \[1\]"),
        ("/**/knee_contact:\n  ros__parameters: 5", "ros__parameters must map names to values, got 5"),
    ],
)
def test_bad_files_are_refused_by_name(tmp_path: Path, content: str, words: str) -> None:
    path = tmp_path / "bad.yaml"
    path.write_text(content)
    with pytest.raises(UsageError, match=words) as caught:
        load_parameters(path)
    assert str(path) in str(caught.value)
    assert "\n" not in str(caught.value)


LEFT, LEG = "/left/knee_contact:\n  ros__parameters: {tibia.geometry: circle}\n", "/l/knee_load:\n  ros__parameters: "


@pytest.mark.parametrize(
    ("schema", "content", "words"),
    [
        (Parameters, "other_node:\n  ros__parameters: {x: 1}", ""),
        (Parameters, LEFT + "/right/knee_contact:\n  ros__parameters: {tibia.slope: 0.1}\n", ""),
        (Parameters, LEFT + "/**:\n  ros__parameters: {tibia.slope: 0.1}\n", r"parameter tibia\.slope: 0\.1 is not al"),
        (Parameters, "/**:\n  ros__parameters: {tibia.slop: 0.1}\n", r"unknown parameter tibia\.slop"),
        (LoadParameters, LEG + "{knee.joint_name: k}\n/r/knee_load:\n  ros__parameters: {knee.joint_name: q}\n", ""),
        (LoadParameters, LEG + "{level: ankle_moment}\n", "parameter level: 'ankle_moment' is not allowed"),
        (LoadParameters, "/**:\n  ros__parameters: {body_weight: 588.4}\n", "unknown parameter body_weight; "),
    ],
)
def test_knees_may_share_a_file(tmp_path: Path, schema: type[NodeSection], content: str, words: str) -> None:
    """What one knee has need not go with what another one has, but with what all have."""
    path = tmp_path / "knees.yaml"
    path.write_text(content)
    if not words:
        check_file(path, schema)
        return
    with pytest.raises(UsageError, match=rf"knees\.yaml: {words}"):
        check_file(path, schema)


PROFILE = {"femur.geometry": "profile", "femur.profile": "{}"}
TABLE = {"translation.mechanism": "table", "translation.table": "{}"}
PLATEAU = {"tibia.geometry": "profile", "tibia.profile": "{}"}


@pytest.mark.parametrize(
    ("values", "content", "words"),
    [
        (PROFILE, "1,2\nx,y\n", "two columns x, y of numbers"),
        (PROFILE, "x,y\n-9.3,18.3\n1,2\n3,4\n5,1\n", "must be in m"),
        (PROFILE, "x,y\n0.1,0.2\n", "at least 4"),
        (PROFILE, "", "at least 4"),
        (PROFILE, None, "cannot read .*: No such file"),
        (PLATEAU, "x,y\n0.0,0.0\n0.01,0.0\n0.005,0.0\n0.02,0.0\n", r"parameter tibia\.profile: .*curve\.csv: "),
        (TABLE, "flexion_angle,x\n0.0,0.0\n0.5\n", "two columns flexion_angle, x of numbers"),
        (TABLE, "0.0,0.0\n0.5,4.5\n", "0.1 m"),
        (TABLE, "0.5,0.0\n0.0,0.001\n", "increase"),
        (TABLE, "0.0,0.0\n", "2"),
        (TABLE, "0,0.0\n30,0.0045\n60,0.0053\n", "reaches 60 rad; flexion angles must be in rad, not deg"),
    ],
)
def test_bad_curves_are_refused(tmp_path: Path, values: dict[str, str], content: str | None, words: str) -> None:
    path = tmp_path / "curve.csv"
    if content is not None:
        path.write_text(content)
    with pytest.raises(UsageError, match=words) as caught:
        knee_contact_ros.load_model({name: value.format(path) for name, value in values.items()})
    assert str(caught.value).startswith(f"parameter {list(values)[1]}: ")
    assert str(path) in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_profile_that_nothing_uses_is_refused(config: Path) -> None:
    """One that a file of both leaves behind, where a circle is asked for, is no mistake."""
    with pytest.raises(UsageError, match=r"femur\.profile: 'x\.csv' is not used; set femur\.geometry to profile"):
        load_parameters([config / "healthy.yaml", {"femur.profile": "x.csv"}])
    assert load_parameters([config / "mri_femur.yaml", {"femur.geometry": "circle"}]).femur.geometry == "circle"
