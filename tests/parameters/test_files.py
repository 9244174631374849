"""Parameters of both nodes, from files and mappings, and the files that they name: what is read and what is refused."""

import json
import os
import random
import re
import warnings
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import knee_contact_ros
from knee_contact_ros.bags.provenance import provenance_record, read_provenance
from knee_contact_ros.commands.main import main
from knee_contact_ros.joint_reaction.estimator import LOAD_LEVELS
from knee_contact_ros.joint_reaction.leg import GRAVITY
from knee_contact_ros.parameters.curves import MAX_CURVE_POINTS, MAX_CURVE_SIZE
from knee_contact_ros.parameters.files import (
    all_values,
    check_file,
    flat_parameters,
    load_parameters,
    variations_of,
)
from knee_contact_ros.parameters.load_schema import LoadParameters, allowed_levels
from knee_contact_ros.parameters.schema import Parameters, has_two_compartments
from knee_contact_ros.parameters.sections import NodeSection
from knee_contact_ros.system.errors import UsageError
from knee_contact_ros.system.files import shipped_parameter_files
from tests.helpers.recordings_of import recording_with


def test_mappings_may_be_nested_dotted_or_a_files_content():
    forms: list[dict[str, Any]] = [
        {"contact": {"damping": 10.0}},
        {"contact.damping": 10.0},
        {"/**": {"ros__parameters": {"contact": {"damping": 10.0}}}},
        {"knee_contact": {"ros__parameters": {"contact.damping": 10.0}}},
        {
            "/**": {"ros__parameters": {"contact.damping": 3.0}},
            "/left/knee_contact": {"ros__parameters": {"contact.damping": 10}},
        },
    ]
    found = [
        load_parameters(form, namespace="left" if "/left/knee_contact" in form else "")
        for form in forms
    ]
    assert all(parameters.contact.damping == 10.0 for parameters in found)


def test_files_are_read_as_ros_reads_them(tmp_path):
    path = tmp_path / "p.yaml"
    path.write_text(
        "knee_contact:\n  ros__parameters:\n    use_sim_time: true\n"
        "    contact: {stiffness: 7.9e7, damping: 5000}\n    fidelity.tolerance: 1e-8\n    rerun: {mode: off}\n"
    )
    parameters = load_parameters(path)
    assert (parameters.contact.stiffness, parameters.contact.damping) == (7.9e7, 5000.0)
    assert parameters.fidelity.tolerance == 1e-8
    assert parameters.rerun.mode == "off"


@pytest.mark.parametrize(
    ("name", "damped"), [("osteoarthritis", True), ("osteoarthritis_as_printed", False)]
)
def test_osteoarthritis_changes_the_law_and_its_layers_alone(name, damped):
    """Of a person's knee, whose parameters were given before."""
    person = {
        "body_weight": 931.6,
        "femur.mass": 11.8,
        "femur.radius": 0.031,
        "load.share": 0.7,
        "contact.stiffness": 6.0e7,
        "fidelity.tolerance": 1.0e-8,
        "contact.layer_depth": 1.0e-3,
        "contact.damp_first_layer": not damped,
    }
    one, other = (flat_parameters(load_parameters([person, *files])) for files in ([], [name]))
    assert {name: other[name] for name in one if one[name] != other[name]} == {
        "contact.law": "two_layer_viscoelastic",
        "contact.layer_depth": 5.0e-4,
        "contact.damp_first_layer": damped,
    }


BOTH = {"load.compartment": "both", "lateral.contact.damping": 2e3}
VARIED: list[dict[str, Any]] = [
    {},
    {"contact.damping": 10},
    {"contact.damping": 1e3, "femur.mass": 8.0, "body_weight": 700.0, "load.share": 0.6},
    {"lateral.contact.damping": 1.0, "contact.damping": 2.0},
    {"lateral.femur.radius": 0.03},
    {"femur.radius": 0.03},
    {"load.compartment": "both", "contact.damping": 3e3},
    {"load.compartment": "total"},
    {"fidelity.budget": 300},
    {"load.compartment": "both", "drive": "displacement"},
    {"contact.damping": -1.0},
    {"contact.damping": "5"},
    {"femur.mass": 8.0, "contact.damping": float("nan")},
    {"contact.dampin": 1.0},
    {"contact": 1.0},
    {"drive": "x"},
    {"tibia.slope": 0.1, "tibia.geometry": "circle"},
    {"tibia.geometry": "circle", "tibia.radius": 0.02},
    {"lateral.tibia.geometry": "circle", "tibia.radius": 0.02},
    {"fidelity.force_tolerance": 1e-10},
]


@pytest.mark.parametrize(
    "common", [{}, BOTH, {"contact.law": "hertz"}], ids=["one", "both", "law"]
)
def test_variations_are_what_is_loaded_and_leave_the_common_ones_as_they_were(
    common,
):
    """Lateral values of a knee that has no lateral compartment mean nothing, and need not follow the medial ones."""
    base = load_parameters(common)
    before, varied = base.model_dump_json(), variations_of(base)
    for values in VARIED:
        loaded = contents(lambda values=values: load_parameters([base, values]))
        assert contents(lambda values=values: varied(values)) == loaded, values
    assert base.model_dump_json() == before


def contents(made):
    """Return all values that an answer depends on, or why there are none."""
    try:
        parameters = made()
    except UsageError as error:
        return str(error)
    return parameters.model_dump_json(
        exclude=None if has_two_compartments(parameters) else {"lateral"}
    )


def test_healthy_is_the_papers_table(config):
    assert load_parameters(config / "healthy.yaml") == load_parameters({})


def test_a_name_means_a_file_here_or_one_of_the_packages_own(config, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    shipped = load_parameters(config / "osteoarthritis.yaml")
    assert load_parameters("osteoarthritis") == load_parameters("osteoarthritis.yaml") == shipped
    (tmp_path / "osteoarthritis").mkdir()  # of reports, say
    assert load_parameters("osteoarthritis") == shipped
    Path("osteoarthritis.yaml").write_text(
        "knee_contact:\n  ros__parameters: {body_weight: 600.0}"
    )
    assert load_parameters("osteoarthritis").body_weight == 600.0
    assert (
        load_parameters(["mri_femur", {"femur.scale": 1.1}, {"body_weight": 500.0}]).femur.scale
        == 1.1
    )
    assert load_parameters([shipped, {"femur.mass": 8.0}]).contact == shipped.contact
    # A profile of one file that another leaves behind is no mistake.
    assert load_parameters(["mri_femur", {"femur.geometry": "circle"}]).femur.geometry == "circle"


def test_files_from_a_spreadsheet_are_read(tmp_path):
    path = tmp_path / "translation.csv"
    path.write_bytes(b"\xef\xbb\xbfflexion_angle,x\r\n  # a remark\r\n0.0,0.0\r\n 1.0, 0.002\r\n")
    model = knee_contact_ros.load_model(
        {"translation.mechanism": "table", "translation.table": str(path)}
    )
    assert model.pair.mechanism.translation(1.0)[0] == 0.002


HIP, ANKLE = {"hip.joint_name": "hip"}, {"ankle.joint_name": "ankle"}
FULL, ON_FOOT = {"ground.components": "full"}, {"ground.axes": "foot"}


def load(values):
    return load_parameters(values, LoadParameters)


@pytest.mark.parametrize(
    ("inputs", "allowed"),
    [
        ({}, 1),
        (FULL, 1),
        (HIP | ANKLE, 1),
        (FULL | HIP, 2),
        (FULL | ANKLE, 1),  # where the shank stands in upright axes, only the hip tells
        (FULL | HIP | ANKLE, 3),
        (FULL | ON_FOOT | HIP, 1),  # where the foot stands, only the ankle tells
        (FULL | ON_FOOT | ANKLE, 3),
        (FULL | ON_FOOT | HIP | ANKLE, 3),
        (HIP | ANKLE | {"ground.components": "net"}, 0),
    ],
)
def test_inputs_allow_levels_and_auto_is_the_last_of_them(inputs, allowed):
    parameters = load(inputs)
    known = list(LOAD_LEVELS)[:allowed] or ["net_load"]
    assert allowed_levels(parameters) == known
    assert parameters.chosen_level == known[-1]
    for level in LOAD_LEVELS:
        if level in known:
            assert load(inputs | {"level": level}).chosen_level == level
            continue
        with pytest.raises(
            UsageError, match=f"^parameter level: '{level}' is not allowed; it needs ground"
        ) as caught:
            load(inputs | {"level": level})
        assert str(caught.value).endswith(f"These inputs allow {', '.join(known)}")


def test_shipped_files_load_and_name_their_level(config):
    names = {f"load/{path.stem}": path for path in shipped_parameter_files("load")}
    assert set(names) == {"load/gait2354", "load/insole", "load/inverse_dynamics", "load/net_load"}
    for name, path in names.items():
        first, level = path.read_text().splitlines()[0], load(name).chosen_level
        assert first.startswith(f"# Level {level}: "), name
        assert load(path) == load(config / "load" / path.name) == load(name)
    assert load("load/insole") == load({})  # it sets the defaults


def test_a_file_has_sections_for_both_nodes(tmp_path):
    path = tmp_path / "leg.yaml"
    path.write_text(
        "/**/knee_load:\n  ros__parameters:\n    person: {mass: 60.0}\n    hip.joint_name: hip\n"
        "/**/knee_contact:\n  ros__parameters:\n    body_weight: 588.4\n"
        "/**:\n  ros__parameters:\n    pairing.wait: 0.5\n    use_sim_time: true\n"
    )
    check_file(path, LoadParameters)
    check_file(path, Parameters)
    ours, others = load(path), load_parameters(path)
    assert (ours.person.mass, ours.hip.joint_name, ours.pairing.wait) == (60.0, "hip", 0.5)
    assert (others.body_weight, others.pairing.wait) == (588.4, 0.5)


CIRCLE = {"tibia.geometry": "circle"}
REFUSED: dict[type[NodeSection], list[tuple[dict[str, Any], str]]] = {
    Parameters: [
        ({"contact.damping": -1.0}, r"damping: -1\.0 .* greater than or equal to 0"),
        ({"contact.damping": "five"}, r"contact\.damping: 'five' is not .* a valid number"),
        ({"contact.damping": float("nan")}, "nan is not allowed; it should be a finite number"),
        ({"contact.law": "hook"}, r"'hook' is not allowed; allowed: .*hertz, kelvin_voigt"),
        (
            {"contact.law": "kelvin_voight"},
            r"gonthier, elastic_foundation; did you mean kelvin_voigt\?",
        ),
        ({"record.max_size": 0.01}, r"0\.01 .*; allowed: 0 \(off\) or a number >= 0\.1"),
        ({"record.path": 10_001 * "x"}, r"'x{79}\.\.\. is not .* at most 10000 characters"),
        ({"fidelity.budget": 5}, r"0 \(a hundred thousand\) or an integer >= 100"),
        ({"knee.flexion_sign": 2.0}, r"2\.0 is not allowed; allowed: 1\.0, -1\.0"),
        ({"contact.dampin": 1.0}, r"unknown .* contact\.dampin; did you mean contact\.damping\?"),
        ({"zzz": 1.0}, r"unknown parameter zzz; the nearest of \d+ are (\S+, ){2}\S+$"),
        ({"femur.geometry": "profile"}, r"femur\.profile is empty"),
        (CIRCLE | {"tibia.slope": 0.1}, r"tibia\.slope: 0\.1 is not allowed; only .* plane"),
        (CIRCLE | {"tibia.radius": 0.034}, r"0\.034 .* exceed femur\.radius, 0\.034"),
        ({"contact.stiffness_from": "material", "contact.exponent": 1.0}, r"1 .* needs 1\.5"),
        ({"contact.law": "elastic_foundation", "contact.tibial_radius": 0.03}, r"0\.03 .* 0\.034"),
        ({"femur.scale": 1.1}, r"femur\.scale: 1\.1 is not allowed; only femur\.geometry profile"),
    ],
    LoadParameters: [
        ({"level": "muscles"}, r"'muscles' is .*auto, ground_force, knee_moment, ankle_moment"),
        ({"knee.joint_name": ""}, r"knee\.joint_name: '' is not allowed"),
        ({"hip.joint_name": "knee"}, r"knee\.joint_name: knee, knee are not different joints"),
        ({"ankle.assisted": True}, r"True is not allowed; ankle\.joint_name is empty"),
        ({"hip.assisted": True}, r"unknown parameter hip\.assisted"),
        ({"frame.ground": "/plate"}, r"'/plate' is not allowed; .*without a slash before it"),
        ({"person.height": 175.0}, r"person\.height: 175\.0 is not allowed; .*2\.5"),
        ({"standard_deviation": 0.001}, r"0\.001 .* 0 \(as measured for the level\) or a num"),
    ],
}
OURS = r"\(healthy, .*osteoarthritis.*\)"
LOAD = r"\(load/gait2354, load/insole, load/inverse_dynamics, load/net_load\)"
NO_SOURCES: tuple[Any, ...] = ("", 3, [None])
MISSING: dict[type[NodeSection], list[tuple[Any, str]]] = {
    Parameters: [
        ("nowhere.yaml", r"nowhere\.yaml: cannot read the parameter file"),
        ("osteoarthritic", rf"^osteoarthritic: .* {OURS}; did you mean osteoarthritis\?$"),
        ("oa", rf"^oa: .* {OURS}; did you mean osteoarthritis\?$"),
        ("xyz", r"own \([^)]*\)$"),
        *(
            (one, r"^parameters: .* is not allowed; a parameter file's name, a mapping of")
            for one in NO_SOURCES
        ),
        (
            ["healthy", {"femur.profile": "x.csv"}],
            r"femur\.profile: 'x\.csv' is not used; set femur\.geometry to profile",
        ),
    ],
    LoadParameters: [
        ("inverse_dynamic", rf"{LOAD}; did you mean load/inverse_dynamics\?$"),
    ],
}
ALL = [
    (schema, *each)
    for table in (REFUSED, MISSING)
    for schema, cases in table.items()
    for each in cases
]


@pytest.mark.parametrize(("schema", "source", "words"), ALL)
def test_what_is_not_allowed_is_refused_in_one_line(schema, source, words):
    with pytest.raises(UsageError, match=words):
        load_parameters(source, schema)


ALL_NODES = "/**:\n  ros__parameters: "


@pytest.mark.parametrize(
    ("content", "words"),
    [
        ("a: [", "not a YAML file"),
        ("- 1", "must map node names"),
        ("other:\n  ros__parameters: {x: 1}", "for node knee_contact; found other"),
        (ALL_NODES + "{contact: {damping: -1.0}}", "contact.damping"),
        ("\xff", "unknown|map node names|YAML"),
        (ALL_NODES + "{femur.mass: 8, femur: {mass: 9.5}}", r"femur\.mass is given twice$"),
        (f"{ALL_NODES}{{}}\n{ALL_NODES}{{}}", r"/\*\* is given twice$"),
        (ALL_NODES + "[1]", r"ros__parameters must map names to values, got \[1\]"),
        (ALL_NODES + "5", "ros__parameters must map names to values, got 5"),
    ],
)
def test_bad_files_are_refused_by_name(tmp_path, content, words):
    path = tmp_path / "bad.yaml"
    path.write_text(content)
    with pytest.raises(UsageError, match=words) as caught:
        load_parameters(path)
    assert str(path) in str(caught.value)


LEFT = "/left/knee_contact:\n  ros__parameters: {tibia.geometry: circle}\n"
LEG = "/l/knee_load:\n  ros__parameters: "
SLOPED = "ros__parameters: {tibia.slope: 0.1}\n"


@pytest.mark.parametrize(
    ("schema", "content", "words"),
    [
        (Parameters, "other_node:\n  ros__parameters: {x: 1}", ""),
        (Parameters, f"{LEFT}/right/knee_contact:\n  {SLOPED}", ""),
        (Parameters, f"{LEFT}/**:\n  {SLOPED}", r"parameter tibia\.slope: 0\.1 is not al"),
        (Parameters, ALL_NODES + "{tibia.slop: 0.1}", r"unknown parameter tibia\.slop"),
        (LoadParameters, f"{LEG}{{knee.joint_name: k}}\n{LEG.replace('l', 'r', 1)}{{}}", ""),
        (LoadParameters, LEG + "{level: ankle_moment}", "parameter level: 'ankle_moment' is not"),
        (LoadParameters, ALL_NODES + "{femur.mass: 9.0}", "unknown parameter femur.mass; "),
    ],
)
def test_knees_may_share_a_file(tmp_path, schema, content, words):
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
NAMED = {"femur.profile": PROFILE, "translation.table": TABLE, "tibia.profile": PLATEAU}


def naming(values, path):
    return {name: value.format(path) for name, value in values.items()}


@pytest.mark.parametrize(
    ("values", "content", "words"),
    [
        (PROFILE, "1,2\nx,y\n", "two columns x, y of numbers"),
        (PROFILE, "x,y\n-9.3,18.3\n1,2\n3,4\n5,1\n", "must be in m"),
        (PROFILE, "x,y\n0.1,0.2\n", "at least 4"),
        (PROFILE, "", "at least 4"),
        (PROFILE, None, "cannot read .*: No such file"),
        (
            PLATEAU,
            "x,y\n0.0,0.0\n0.01,0.0\n0.005,0.0\n0.02,0.0\n",
            r"parameter tibia\.profile: .*curve\.csv: ",
        ),
        (TABLE, "flexion_angle,x\n0.0,0.0\n0.5\n", "two columns flexion_angle, x of numbers"),
        (TABLE, "0.0,0.0\n0.5,4.5\n", "0.1 m"),
        (TABLE, "0.5,0.0\n0.0,0.001\n", "increase"),
        (TABLE, "0.0,0.0\n", "2"),
        (
            TABLE,
            "0,0.0\n30,0.0045\n60,0.0053\n",
            "reaches 60 rad; flexion angles must be in rad, not deg",
        ),
    ],
)
def test_bad_curves_are_refused(tmp_path, values, content, words):
    path = tmp_path / "curve.csv"
    if content is not None:
        path.write_text(content)
    with pytest.raises(UsageError, match=words) as caught:
        knee_contact_ros.load_model(naming(values, path))
    assert str(caught.value).startswith(f"parameter {list(values)[1]}: ")
    assert str(path) in str(caught.value)


@pytest.mark.parametrize("parameter", NAMED)
def test_what_is_no_file_or_too_large_is_refused_by_the_parameter(parameter, tmp_path):
    os.mkfifo(tmp_path / "pipe")
    for no_file in (
        tmp_path / "pipe",
        "/dev/zero",
        tmp_path,
        "a\0b",
        "~nobody_of_this_name/x.csv",
    ):
        with pytest.raises(UsageError, match=f"parameter {parameter}: cannot read"):
            knee_contact_ros.load_model(naming(NAMED[parameter], no_file))
    path = tmp_path / "curve.csv"
    path.write_text("".join(f"{number * 1e-6:g},0\n" for number in range(MAX_CURVE_POINTS + 1)))
    words = f"parameter {parameter}: .* has {MAX_CURVE_POINTS + 1} points; at most {MAX_CURVE_POINTS} are allowed"
    with pytest.raises(UsageError, match=words):
        knee_contact_ros.load_model(naming(NAMED[parameter], path))
    path.write_text("#" * (MAX_CURVE_SIZE + 1))
    with pytest.raises(UsageError, match="longer than"):
        knee_contact_ros.load_model(naming(NAMED[parameter], path))


def test_no_file_is_opened_that_a_recording_names(right_bag, config, tmp_path, capsys):
    """A pipe that is opened would never end. Of view and report: `tests/hostile`."""
    recording, pipe = tmp_path / "theirs.mcap", tmp_path / "pipe"
    os.mkfifo(pipe)
    record = provenance_record(load_parameters({}), {}) | {
        "parameters": json.dumps(naming(PROFILE, pipe))
    }
    recording_with(recording, right_bag, [("knee_contact", record)])
    how = ["solve", str(recording), "--output", str(tmp_path / "out.mcap")]
    assert main(how) == 2
    assert capsys.readouterr().err == (
        f"knee-contact: {recording} does not hold the file that its parameter femur.profile names ({pipe}): give your "
        "own with -p femur.profile:=FILE, or all parameters with --params\n"
    )
    assert main([*how, "-p", f"femur.profile:={config / 'femur_medial.csv'}"]) == 0


@pytest.mark.parametrize(
    "parameters", ['"/dev/zero"', '["/dev/zero"]', "[" * 100_000, '{"a": ' * 500 + "1" + "}" * 500]
)
def test_parameters_of_a_recording_are_names_and_values(parameters, right_bag, tmp_path):
    """A text or a list would be names of files."""
    record = provenance_record(load_parameters({}), {}) | {"parameters": parameters}
    recording_with(tmp_path / "theirs.mcap", right_bag, [("knee_contact", record)])
    with pytest.raises(
        UsageError,
        match="its record knee_contact, which has the parameters, is damaged: give --params",
    ):
        read_provenance(tmp_path / "theirs.mcap")


@pytest.mark.parametrize(
    ("origin", "words"),
    [
        ([0.0, 0.4], r"touches the tibia at x = 0 to 346 mm .* \(fit-profile --origin\)\?"),
        ([0.1, 0.0], r"touches the tibia at x = -100 to -50 mm .* \(fit-profile --origin\)\?"),
        ([0.01, 0.01], ""),
    ],
)
def test_a_femur_that_leaves_the_plateau_is_reported(origin, words, tmp_path):
    """The arc's centre lies near the femur's origin, or far from it as of a mesh from a scanner."""
    turn = np.linspace(2.2, -0.3, 60)
    path = tmp_path / "curve.csv"
    arc = -0.03 * np.column_stack([np.sin(turn), np.cos(turn)]) - origin
    path.write_text("".join(f"{x:.6f},{y:.6f}\n" for x, y in arc))
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        knee_contact_ros.load_model(naming(PROFILE, path))
    assert [bool(re.search(words, str(each.message))) for each in caught] == (
        [True] if words else []
    )


@pytest.mark.parametrize(
    ("name", "text", "number"),
    [
        ("contact.stiffness", "8e7", 8e7),
        ("fidelity.tolerance", "1e-06", 1e-6),
        ("contact.damping", "5000", 5000.0),
        ("fidelity.budget", "20000", 20_000),
    ],
)
def test_a_number_may_be_a_text(name, text, number):
    assert all_values(load_parameters({name: text}))[name] == number
    assert all_values(load_parameters({"record.path": "12"}))["record.path"] == "12"


PERSON = {"person.mass": 92.0, "knee": {"joint_name": "motor", "sign": -1.0, "offset": 0.1}}
"""What is entered once for both nodes, under the names of the load node"""


def sections_of(draw):
    """A file's content: the person and the encoder in a section of one node, or of both, under either's names."""
    as_contact = {
        "body_weight": 92.0 * GRAVITY,
        "knee": {"joint_name": "motor", "flexion_sign": -1.0, "flexion_offset": 0.1},
    }
    section = draw.choice(
        ("/**", "knee_load", "knee_contact", "/**/knee_load", "/**/knee_contact")
    )
    own = as_contact if "contact" in section or draw.random() < 0.5 else PERSON
    content: dict[str, Any] = {section: {"ros__parameters": dict(own)}}
    for node, values in (
        ("knee_load", {"person.height": 1.9}),
        ("knee_contact", {"drive": "force"}),
    ):
        place = content.setdefault(node, {"ros__parameters": {}})["ros__parameters"]
        if "/" in section or node != section:
            place |= values
    return content


@pytest.mark.parametrize("seed", range(20))
def test_person_and_encoder_are_entered_once_for_both_nodes(seed):
    content = sections_of(random.Random(seed))
    contact = load_parameters(content)
    load = load_parameters(content, LoadParameters)
    assert contact.body_weight == pytest.approx(load.person.mass * GRAVITY, rel=1e-12)
    assert load.person.mass == pytest.approx(92.0, rel=1e-12)
    for knee, sign, offset in (
        (contact.knee, contact.knee.flexion_sign, contact.knee.flexion_offset),
        (load.knee, load.knee.sign, load.knee.offset),
    ):
        assert (knee.joint_name, sign, offset) == ("motor", -1.0, 0.1)


def test_mass_and_weight_check_each_other_and_encoders_may_differ():
    content = {
        "knee_load": {"ros__parameters": dict(PERSON)},
        "knee_contact": {"ros__parameters": {"body_weight": 737.068}},
    }
    for schema in (Parameters, LoadParameters):
        with pytest.raises(UsageError, match=r"not allowed beside .*give one of them"):
            load_parameters(content, schema)
    content["knee_contact"] = {"ros__parameters": {"knee.joint_name": "another"}}
    assert load_parameters(content).knee.flexion_sign == 1.0
