"""Parameter files and mappings: what is read, and what is refused in one line."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

import knee_contact_ros
from knee_contact_ros.parameters.files import flat_parameters, load_parameters, variations_of
from knee_contact_ros.parameters.schema import Femur, Parameters, has_both
from knee_contact_ros.system.errors import UsageError


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
    found = [load_parameters(form, namespace="left" if "/left/knee_contact" in form else "") for form in forms]
    assert all(parameters.contact.damping == 10.0 for parameters in found)


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


def test_osteoarthritis_changes_the_law_and_its_layers_alone(config: Path) -> None:
    """Of a person's knee, whose parameters were given before."""
    person = {
        "body_weight": 931.6, "femur.mass": 11.8, "femur.radius": 0.031, "load.share": 0.7, "contact.stiffness": 6.0e7,
        "fidelity.tolerance": 1.0e-8, "contact.layer_depth": 1.0e-3, "contact.damp_first_layer": True,
    }  # fmt: skip
    one, other = (
        flat_parameters(load_parameters([person, *files])) for files in ([], [config / "osteoarthritis.yaml"])
    )
    assert {name: other[name] for name in one if one[name] != other[name]} == {
        "contact.law": "two_layer_viscoelastic", "contact.layer_depth": 5.0e-4, "contact.damp_first_layer": False,
    }  # fmt: skip


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


def test_healthy_is_the_papers_table(config: Path) -> None:
    assert load_parameters(config / "healthy.yaml") == load_parameters({})


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


def test_files_from_a_spreadsheet_are_read(tmp_path: Path) -> None:
    path = tmp_path / "translation.csv"
    path.write_bytes(b"\xef\xbb\xbfflexion_angle,x\r\n  # a remark\r\n0.0,0.0\r\n 1.0, 0.002\r\n")
    model = knee_contact_ros.load_model({"translation.mechanism": "table", "translation.table": str(path)})
    assert model.pair.mechanism.translation(1.0)[0] == 0.002


@pytest.mark.parametrize("source", [None, "", 3, [None], ["healthy", ""]])
def test_what_is_no_source_is_refused_in_a_line(source: Any) -> None:
    with pytest.raises(UsageError, match=r"^parameters: .* is not allowed; a parameter file's name, a mapping of"):
        load_parameters(source)


def test_lateral_values_follow_sections_that_are_given_as_objects() -> None:
    assert Parameters(femur=Femur(radius=0.03)) == load_parameters({"femur.radius": 0.03})
    own = Parameters.model_validate({"lateral": {"femur": Femur(radius=0.02)}})
    assert (own.femur.radius, own.lateral.femur.radius) == (Femur().radius, 0.02)
