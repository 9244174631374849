"""Parameter files and mappings: what is read, and what is refused in one line."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

import knee_contact_ros
from knee_contact_ros.parameters.files import (
    check_file,
    flat_parameters,
    known_parameters,
    load_parameters,
    variations_of,
)
from knee_contact_ros.parameters.schema import Parameters, has_both
from knee_contact_ros.system.errors import UsageError

CONTRACT = {
    "knee.joint_name": "knee", "knee.flexion_sign": 1.0, "knee.flexion_offset": 0.0,
    "load.compartment": "fixed_share", "load.share": 0.5, "load.share_file": "share_medial.csv",
    "load.compartment_spacing": 0.04, "drive": "force",
    "femur.mass": 9.3014, "femur.geometry": "circle", "femur.radius": 0.034, "femur.profile": "",
    "tibia.geometry": "plane", "tibia.slope": 0.0, "tibia.radius": 0.095, "translation.mechanism": "hinge",
    "contact.law": "kelvin_voigt", "contact.stiffness": 7.905694e7, "contact.exponent": 1.5, "contact.damping": 5000.0,
    "contact.allow_tension": False, "contact.layer_depth": 5.0e-4, "contact.stiffness_2": 3.112e9,
    "contact.damp_first_layer": False, "fidelity.level": "auto", "fidelity.tolerance": 1.0e-6,
    "fidelity.force_tolerance": 0.0, "fidelity.budget": 20_000,
    "body_weight": 737.068, "autostart": True, "record.path": "", "record.flush_period": 0.03,
    "record.sync_period": 1.0, "record.queue": 30000, "record.queue_size": 100.0,
    "rerun.queue": 20000, "rerun.queue_size": 64.0,
    "record.max_size": 0.0, "record.max_duration": 0.0, "record.min_free": 100.0,
    "rerun.mode": "off", "rerun.path": "", "rerun.port": 9876, "rerun.knees": "",
}  # fmt: skip


def test_names_and_defaults_hold() -> None:
    defaults = {name: known.default for name, known in known_parameters().items()}
    assert {name: defaults[name] for name in CONTRACT} == CONTRACT
    assert all(known.description for known in known_parameters().values())


@pytest.mark.parametrize(
    ("name", "value", "allowed"),
    [
        ("contact.damping", -1.0, "greater than or equal to 0"),
        ("contact.damping", "5000", "valid number"),
        ("contact.damping", True, "valid number"),
        ("contact.damping", float("nan"), "finite"),
        ("contact.law", "hook", "hertz, kelvin_voigt"),
        ("record.max_size", 0.01, "allowed: 0 (off) or a number >= 0.1"),
        ("record.max_size", -1.0, "allowed: 0 (off) or a number >= 0.1"),
        ("record.max_duration", 0.5, "allowed: 0 (off) or a number >= 1"),
        ("record.min_free", -1.0, "greater than or equal to 0"),
        ("contact.exponent", 0.5, "greater than or equal to 1"),
        ("contact.allow_tension", 1, "valid boolean"),
        ("femur.mass", 0.0, "greater than or equal to 0.0001"),
        ("femur.geometry", "square", "circle, profile"),
        ("fidelity.force_tolerance", 1e-10, "0 (off) or a number >= 1e-09"),
        ("fidelity.force_tolerance", 2e6, "1000000"),
        ("fidelity.budget", 5, "0 (a hundred thousand) or an integer >= 100"),
        ("fidelity.budget", 0.5, "integer"),
        ("knee.flexion_sign", 2.0, "1.0, -1.0"),
        ("load.share", 1.5, "less than or equal to 1"),
        ("body_weight", 0.0, "greater than 0"),
        ("drive", "torque", "force, displacement"),
    ],
)
def test_values_out_of_range_are_refused_in_one_line(name: str, value: Any, allowed: str) -> None:
    with pytest.raises(UsageError) as caught:
        load_parameters({name: value})
    text = str(caught.value)
    assert name in text
    assert repr(value) in text
    assert allowed in text
    assert "\n" not in text


def test_unknown_names_are_refused_with_what_was_meant() -> None:
    with pytest.raises(UsageError, match=r"unknown parameter contact\.dampin; did you mean contact\.damping\?"):
        load_parameters({"contact.dampin": 1.0})
    with pytest.raises(UsageError, match=r"unknown parameter zzz; known are knee\.joint_name.*, lateral\.\* \("):
        load_parameters({"zzz": 1.0})


def test_mappings_may_be_nested_dotted_or_a_files_content() -> None:
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
    assert all(load_parameters(form).contact.damping == 10.0 for form in forms)


def test_files_are_read_as_ros_reads_them(tmp_path: Path) -> None:
    path = tmp_path / "p.yaml"
    path.write_text(
        "knee_contact:\n  ros__parameters:\n    use_sim_time: true\n"
        "    contact: {stiffness: 7.9e7, damping: 5000}\n    fidelity.tolerance: 1e-8\n    rerun: {mode: off}\n"
    )
    parameters = load_parameters(path)
    assert (parameters.contact.stiffness, parameters.contact.damping) == (7.9e7, 5000.0)
    assert parameters.fidelity.tolerance == 1e-8
    assert parameters.rerun.mode == "off"


def test_later_files_win(config: Path) -> None:
    parameters = load_parameters([config / "osteoarthritis.yaml", config / "mri_femur.yaml"])
    assert parameters.contact.law == "two_layer_viscoelastic"
    assert parameters.femur.geometry == "profile"


def test_osteoarthritis_changes_the_law_alone(config: Path) -> None:
    """Of the paper's knee, and of a person's whose parameters were given before."""
    changed = {"contact.law"}  # the layer's constants are the defaults
    person = {
        "body_weight": 931.6, "femur.mass": 11.8, "femur.radius": 0.031, "load.share": 0.7, "contact.stiffness": 6.0e7,
        "fidelity.tolerance": 1.0e-8, "contact.layer_depth": 1.0e-3, "contact.damp_first_layer": True,
    }  # fmt: skip
    for before, layer in (({}, set()), (person, {"contact.layer_depth", "contact.damp_first_layer"})):
        one, other = (
            flat_parameters(load_parameters(files)) for files in ([before], [before, config / "osteoarthritis.yaml"])
        )
        assert {name for name in one if one[name] != other[name]} == changed | layer
        assert (other["contact.law"], other["contact.layer_depth"]) == ("two_layer_viscoelastic", 5.0e-4)
        assert (other["contact.stiffness_2"], other["contact.damp_first_layer"]) == (3.112e9, False)


BOTH = {"load.compartment": "both", "lateral.contact.damping": 2e3}
VARIED: list[dict[str, Any]] = [
    {}, {"contact.damping": 10}, {"contact.damping": 1e3, "femur.mass": 8.0, "body_weight": 700.0, "load.share": 0.6},
    {"lateral.contact.damping": 1.0, "contact.damping": 2.0}, {"lateral.femur.radius": 0.03}, {"femur.radius": 0.03},
    {"load.compartment": "both", "contact.damping": 3e3}, {"load.compartment": "total"}, {"fidelity.budget": 300},
    {"load.compartment": "both", "drive": "displacement"}, {"contact.damping": -1.0}, {"contact.damping": "5"},
    {"femur.mass": 8.0, "contact.damping": float("nan")}, {"contact.dampin": 1.0}, {"contact": 1.0}, {"drive": "x"},
    {"tibia.slope": 0.1, "tibia.geometry": "circle"}, {"tibia.geometry": "circle", "tibia.radius": 0.02},
    {"lateral.tibia.geometry": "circle", "tibia.radius": 0.02}, {"fidelity.force_tolerance": 1e-10},
]  # fmt: skip


@pytest.mark.parametrize("common", [{}, BOTH, {"contact.law": "hertz"}], ids=["one", "both", "law"])
def test_variations_are_what_is_loaded_and_leave_the_common_ones_as_they_were(common: dict[str, Any]) -> None:
    """Lateral values of a knee that has no lateral compartment mean nothing, and need not follow the medial ones."""
    base = load_parameters(common)
    before, varied = base.model_dump_json(), variations_of(base)
    for values in VARIED:
        found = [
            told(lambda values=values: varied(values)),
            told(lambda values=values: load_parameters([base, values])),
        ]
        assert found[0] == found[1], values
    assert base.model_dump_json() == before


def told(made: Callable[[], Parameters]) -> str:
    """All that makes an answer of some parameters, or why there are none."""
    try:
        parameters = made()
    except UsageError as error:
        return str(error)
    return parameters.model_dump_json(exclude=None if has_both(parameters) else {"lateral"})


@pytest.mark.parametrize("name", ["healthy.yaml", "osteoarthritis.yaml", "mri_femur.yaml", "mri_knee.yaml"])
def test_shipped_files_load(config: Path, name: str) -> None:
    knee_contact_ros.load_model(config / name)


def test_healthy_is_the_papers_table(config: Path) -> None:
    assert load_parameters(config / "healthy.yaml") == load_parameters({})


@pytest.mark.parametrize(
    ("content", "words"),
    [
        ("a: [", "not a YAML file"),
        ("- 1", "must map node names"),
        ("other_node:\n  ros__parameters: {x: 1}", "no parameters for node knee_contact; found other_node"),
        ("/**:\n  ros__parameters: {contact: {damping: -1.0}}", "contact.damping"),
        ("\xff", "unknown|map node names|YAML"),
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


def test_a_missing_file_is_refused() -> None:
    with pytest.raises(UsageError, match=r"nowhere\.yaml: cannot read the parameter file"):
        load_parameters("nowhere.yaml")
    with pytest.raises(
        UsageError, match=r"^osteoarthritic: .* \(healthy, .*osteoarthritis\); did you mean osteoarthritis\?$"
    ):
        load_parameters("osteoarthritic")
    with pytest.raises(UsageError, match=r"own \([^)]*\)$"):
        load_parameters("xyz")


def test_a_name_means_a_file_here_or_one_of_the_packages_own(
    config: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    shipped = load_parameters(config / "osteoarthritis.yaml")
    assert load_parameters("osteoarthritis") == load_parameters("osteoarthritis.yaml") == shipped
    (tmp_path / "osteoarthritis").mkdir()  # of reports, say
    assert load_parameters("osteoarthritis") == shipped
    Path("osteoarthritis.yaml").write_text("knee_contact:\n  ros__parameters: {body_weight: 600.0}")
    assert load_parameters("osteoarthritis").body_weight == 600.0
    assert load_parameters(["mri_femur", {"femur.scale": 1.1}, {"body_weight": 500.0}]).femur.scale == 1.1
    assert load_parameters([shipped, {"femur.mass": 8.0}]).contact == shipped.contact


def test_files_for_other_nodes_are_none_of_the_nodes_business(tmp_path: Path) -> None:
    path = tmp_path / "other.yaml"
    path.write_text("other_node:\n  ros__parameters: {x: 1}")
    check_file(path, Parameters)


def test_knees_may_share_a_file(tmp_path: Path) -> None:
    """What one knee has need not go with what another one has, but with what all have."""
    path = tmp_path / "knees.yaml"
    left = "/left/knee_contact:\n  ros__parameters: {tibia.geometry: circle}\n"
    right = "/right/knee_contact:\n  ros__parameters: {tibia.slope: 0.1}\n"
    path.write_text(left + right)
    check_file(path, Parameters)
    path.write_text(left + "/**:\n  ros__parameters: {tibia.slope: 0.1}\n")
    with pytest.raises(UsageError, match=r"knees\.yaml: parameter tibia\.slope: 0\.1 is not allowed"):
        check_file(path, Parameters)
    path.write_text("/**:\n  ros__parameters: {tibia.slop: 0.1}\n")
    with pytest.raises(UsageError, match=r"knees\.yaml: unknown parameter tibia\.slop"):
        check_file(path, Parameters)


@pytest.mark.parametrize(
    ("content", "words"),
    [
        ("1,2\nx,y\n", "two columns x, y of numbers"),
        ("x,y\n-9.3,18.3\n1,2\n3,4\n5,1\n", "must be in m"),
        ("x,y\n0.1,0.2\n", "at least 4"),
        ("", "at least 4"),
        (None, "cannot read .*: No such file"),
    ],
)
def test_bad_profiles_are_refused(tmp_path: Path, content: str | None, words: str) -> None:
    path = tmp_path / "profile.csv"
    if content is not None:
        path.write_text(content)
    with pytest.raises(UsageError, match=words) as caught:
        knee_contact_ros.load_model({"femur.geometry": "profile", "femur.profile": str(path)})
    assert str(path) in str(caught.value)


def test_a_profile_needs_its_file() -> None:
    with pytest.raises(UsageError, match=r"femur\.profile is empty"):
        load_parameters({"femur.geometry": "profile"})


@pytest.mark.parametrize(
    ("values", "words"),
    [
        ({"tibia.geometry": "profile"}, r"tibia\.profile is empty"),
        ({"translation.mechanism": "table"}, r"translation\.table is empty"),
        ({"tibia.geometry": "circle", "tibia.slope": 0.1}, r"tibia\.slope: 0\.1 is not allowed; only .* plane"),
        ({"tibia.geometry": "circle", "tibia.radius": 0.034}, r"tibia\.radius: 0\.034 .* exceed femur\.radius, 0\.034"),
        ({"contact.stiffness_from": "material", "contact.exponent": 1.0}, r"contact\.exponent: 1 .* needs 1\.5"),
        ({"contact.law": "elastic_foundation", "contact.tibial_radius": 0.03}, r"tibial_radius: 0\.03 .* 0\.034"),
        ({"contact.restitution": 0.0}, "greater than or equal to 0.01"),
        ({"contact.poissons_ratio": 0.5}, "less than 0.5"),
    ],
)
def test_values_that_do_not_go_together_are_refused_in_one_line(values: dict[str, Any], words: str) -> None:
    with pytest.raises(UsageError, match=words) as caught:
        load_parameters(values)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("content", "words"),
    [
        ("flexion_angle,x\n0.0,0.0\n0.5\n", "two columns flexion_angle, x of numbers"),
        ("0.0,0.0\n0.5,4.5\n", "0.1 m"),
        ("0.5,0.0\n0.0,0.001\n", "increase"),
        ("0.0,0.0\n", "2"),
        ("0,0.0\n30,0.0045\n60,0.0053\n", "reaches 60 rad; flexion angles must be in rad, not deg"),
    ],
)
def test_bad_translations_are_refused(tmp_path: Path, content: str, words: str) -> None:
    path = tmp_path / "translation.csv"
    path.write_text(content)
    with pytest.raises(UsageError, match=words) as caught:
        knee_contact_ros.load_model({"translation.mechanism": "table", "translation.table": str(path)})
    assert str(path) in str(caught.value)
    assert "parameter translation.table" in str(caught.value)


def test_bad_plateaus_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "tibia.csv"
    path.write_text("x,y\n0.0,0.0\n0.01,0.0\n0.005,0.0\n0.02,0.0\n")
    with pytest.raises(UsageError, match=r"parameter tibia\.profile: .*tibia\.csv: ") as caught:
        knee_contact_ros.load_model({"tibia.geometry": "profile", "tibia.profile": str(path)})
    assert "\n" not in str(caught.value)


def test_files_from_a_spreadsheet_are_read(tmp_path: Path) -> None:
    path = tmp_path / "translation.csv"
    path.write_bytes(b"\xef\xbb\xbfflexion_angle,x\r\n  # a remark\r\n0.0,0.0\r\n 1.0, 0.002\r\n")
    model = knee_contact_ros.load_model({"translation.mechanism": "table", "translation.table": str(path)})
    assert model.pair.mechanism.translation(1.0)[0] == 0.002


@pytest.mark.parametrize("source", [None, "", 3, [None], ["healthy", ""]])
def test_what_is_no_source_is_refused_in_a_line(source: Any) -> None:
    with pytest.raises(UsageError, match=r"^parameters: .* is not allowed; a parameter file's name, a mapping of"):
        load_parameters(source)
