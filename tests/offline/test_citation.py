"""What is cited of a bag."""

import re

import pytest

from knee_contact_ros import __version__
from knee_contact_ros.bags.bag import Bag
from knee_contact_ros.bags.provenance import PARAMETERS_CHANGED, RESET
from knee_contact_ros.model.laws import CONTACT_LAWS
from knee_contact_ros.offline.bag_parameters import basis_of
from knee_contact_ros.offline.citation import citation, comment_of, law_text
from knee_contact_ros.offline.estimate_load import estimate_load, load_parameters_for
from knee_contact_ros.offline.solve import solve
from knee_contact_ros.parameters.files import load_parameters
from knee_contact_ros.streams.output import TICK
from knee_contact_ros.system.errors import UsageError
from tests.helpers.walking import walk, walking_bag


def cited(bag):
    with Bag(bag) as opened:
        return citation(opened)


def solved(bag, output, params="healthy", **values):
    with Bag(bag) as opened:
        basis = basis_of(
            opened,
            [params],
            {name.replace("__", "."): each for name, each in values.items()},
            None,
        )
        solve(opened, basis, output)
    return cited(output)


def test_a_recording_names_software_model_law_surfaces_and_load(right_bag, tmp_path):
    parts = solved(right_bag, tmp_path / "a.mcap", body_weight=700.0, contact__damping=4000.0)
    assert f"knee_contact_ros {__version__}," in parts["software"]
    assert "Acta Mechanica et Automatica, article 219102" in parts["model"]
    assert parts["law"] == (
        "kelvin_voigt: stiffness 7.90569e+07 N/m^exponent, exponent 1.5, damping 4000 N s/m. "
        "Source: the model's paper, Eqs. 8, 10"
    )
    assert parts["surfaces"] == (
        "femur: circle with a radius of 0.034 m; tibia: plane with a slope of 0 rad"
    )
    assert parts["load"] == "fixed_share: 0.5 of the axial joint reaction; body weight 700 N"
    assert parts["input"].startswith("gait2354_right;")


def test_files_of_surfaces_and_shares_are_cited_from_the_recording(right_bag, tmp_path):
    parts = solved(
        right_bag,
        tmp_path / "a.mcap",
        "mri_femur",
        load__compartment="both",
        load__split="measured_share",
        lateral__femur__profile="femur_lateral.csv",
        lateral__femur__geometry="profile",
        lateral__contact__law="flores",
        translation__mechanism="table",
        translation__table="translation_medial.csv",
    )
    assert "sagittal slice 18 mm medial" in parts["medial surfaces"]
    assert "doi:10.1007/s10439-015-1326-3" in parts["medial surfaces"]
    assert "sagittal slice 24.2 mm lateral" in parts["lateral surfaces"]
    assert parts["medial law"].startswith("kelvin_voigt: ")
    assert parts["lateral law"].endswith(
        "Flores, Machado, Silva & Martins 2011, doi:10.1007/s11044-010-9237-4"
    )
    assert "doi:10.1016/j.jbiomech.2021.110536" in parts["translation"]
    assert "n = 2: two men" in parts["load"]


@pytest.mark.parametrize("law", CONTACT_LAWS)
def test_every_law_has_a_source(law):
    text = law_text(load_parameters({"contact.law": law}))
    assert re.search(r"Source: (the model's paper, Eqs?\. \d+|.*doi:10\.\d{4}/\S*\w$)", text), text


def test_a_stiffness_from_the_material_and_a_departure_from_the_paper_are_told():
    values = {"contact.law": "two_layer_viscoelastic", "contact.stiffness_from": "material"}
    text = law_text(load_parameters(values))
    radius = 1.0 / (1.0 / 0.034 - 1.0 / 0.095)
    stiffness = 4.0 / 3.0 * 24e6 / (2.0 * (1.0 - 0.38**2)) * radius**0.5
    assert f" stiffness {stiffness:.6g} N/m^exponent" in text
    assert text.endswith("from the material. Source: the model's paper, Eq. 12")
    assert "dashpot" not in text
    damped = law_text(load_parameters(values | {"contact.damp_first_layer": True}))
    assert "in the first layer, too, which the paper has not" in damped


def test_an_estimated_load_and_an_imported_gait(right_bag, sensors_bag, tmp_path):
    assert "OpenSim 4.6" in cited(right_bag)["gait"]
    output = tmp_path / "load.mcap"
    with Bag(sensors_bag) as opened:
        values = {"person.mass": 61.5, "person.expected_load": 0.0}
        parameters, _, _ = load_parameters_for(opened, [], values, "")
        estimate_load(opened, parameters, output)
    parts = cited(output)
    assert f"knee_contact_ros {__version__}." in parts["software"]
    assert "level ground_force, body mass 61.5 kg" in parts["load estimate"]
    assert "constants not fitted to this person" in parts["load estimate"]
    assert "mean curve" not in parts["load estimate"]
    assert "model" not in parts


def test_changes_while_it_was_recorded_are_told(right_bag, tmp_path):
    solved(right_bag, tmp_path / "a.mcap")
    with Bag(tmp_path / "a.mcap") as bag:
        assert "changes" not in citation(bag)
        bag.metadata.append((PARAMETERS_CHANGED, {TICK: "7", "contact.damping": "1.0"}))
        bag.metadata.append((RESET, {TICK: "9"}))
        assert citation(bag)["changes"] == (
            "2 changes or resets while it was recorded, of contact.damping"
        )


def test_a_bag_that_says_nothing_is_refused(tmp_path):
    with pytest.raises(UsageError, match="does not say how it was made"):
        cited(walking_bag(tmp_path / "walk.mcap", walk()))


def test_only_the_comment_at_the_top_is_repeated():
    assert comment_of("# one\n#  two\nx,y\n# three\n") == "one two"
    assert comment_of("x,y\n") == "its file does not say where it comes from"
    assert len(comment_of("# " + "word " * 10_000)) < 1000
