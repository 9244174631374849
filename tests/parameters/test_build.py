"""From names to models, in this process and another; subject files; and implausible parameters are reported."""

import copy
import shutil
import warnings
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from typing import Annotated

import numpy as np
import pytest
from pydantic import ValidationError

import knee_contact_ros
from knee_contact_ros.bags.provenance import read_provenance
from knee_contact_ros.commands.main import main
from knee_contact_ros.lab.study_file import Study
from knee_contact_ros.model.knee import BUDGET
from knee_contact_ros.model.laws import CONTACT_LAWS, ContactLaw, Layer, Range
from knee_contact_ros.model.ticks import LEVELS
from knee_contact_ros.model.types import ROW
from knee_contact_ros.parameters import schema
from knee_contact_ros.parameters.build import build_model, retuned
from knee_contact_ros.parameters.files import load_parameters
from knee_contact_ros.parameters.load_schema import LoadParameters
from knee_contact_ros.parameters.schema import ContactSection, with_constants_of_laws
from knee_contact_ros.parameters.subjects import Subject
from knee_contact_ros.streams.watch import Doubts, doubts_about
from knee_contact_ros.system.errors import UsageError
from tests.offline.test_solve import make_bag

TIME = np.arange(0.0, 0.1, 0.005)
ANGLE = 0.3 + 0.3 * np.sin(20.0 * TIME)
LOAD = 700.0 + 200.0 * np.sin(25.0 * TIME)


@pytest.mark.parametrize("law", CONTACT_LAWS)
def test_every_law_works_with_both_drives(law):
    names = {"contact.law": law, "tibia.geometry": "circle", "fidelity.tolerance": 1e-9}
    forced = knee_contact_ros.load_model(names).run(TIME, ANGLE, LOAD)
    led = knee_contact_ros.load_model(names | {"drive": "displacement"})
    followed = led.run(TIME, ANGLE, LOAD, forced.femoral_height)
    # Rounding of heights of 34 mm
    assert followed.penetration_depth == pytest.approx(forced.penetration_depth, abs=1e-16)
    for contact in followed:
        layer = [layer for layer in led.law.layers if layer.begin < contact.penetration_depth][-1]
        # Pressed from the start, which counts as no impact
        force = layer.force_at(contact.penetration_depth, contact.penetration_rate, 0.0)[0]
        # The very numbers that were published go into the very formula.
        assert contact.contact_force == max(force, 0.0)
    for series in (forced, followed):
        for field in (
            "contact_force",
            "penetration_depth",
            "penetration_rate",
            "femoral_height",
            "error_estimate",
        ):
            assert np.isfinite(series[field]).all(), field
        assert np.all(series.contact_force >= 0.0)


def test_stiffness_from_the_material_is_hertz():
    names = {
        "contact.stiffness_from": "material",
        "contact.law": "two_layer_elastic",
        "contact.layer_depth": 0.005,
    }
    law = knee_contact_ros.load_model(names).law
    cartilage, bone = (
        136.08 * 10**4.5,
        98_408 * 10**4.5,
    )  # N/mm^1.5 by hand from E, nu, 34 mm and 95 mm
    # The numbers by hand have 5 digits.
    assert law.static_force(1e-3) == pytest.approx(cartilage * 1e-3**1.5, rel=1e-4)
    beyond = law.static_force(0.005) + bone * 1e-3**1.5
    assert law.static_force(0.006) == pytest.approx(beyond, rel=1e-4)


def test_numbers_reach_the_model_when_it_is_made_and_when_they_change():
    model = knee_contact_ros.load_model({"fidelity.force_tolerance": 2.5})
    assert (model.force_tolerance, model.constants.force_tolerance) == (2.5, 2.5)
    assert (model.constants.level, model.constants.budget, model.constants.allow_tension) == (
        LEVELS["dynamic"],
        BUDGET,
        False,
    )
    fresh = knee_contact_ros.load_model({}).constants
    assert fresh.force_tolerance == 0.0
    changes = {
        "fidelity.force_tolerance": 0.1,
        "fidelity.tolerance": 1e-8,
        "fidelity.budget": 300,
        "femur.mass": 8.0,
        "fidelity.level": "quasi_static",
        "contact.allow_tension": True,
        "contact.stiffness": 5e7,
    }
    changed, made = retuned(model, load_parameters(changes)), knee_contact_ros.load_model(changes)
    assert changed.pair is model.pair
    for name in ("mass", "tolerance", "force_tolerance", "budget", "level", "allow_tension"):
        assert (
            getattr(changed.constants, name)
            == getattr(made.constants, name)
            != getattr(fresh, name)
        ), name
    assert changed.law == made.law
    assert changed.patch == made.patch


def test_a_level_of_earlier_versions_is_dynamic_and_one_line_is_logged(
    caplog,
):
    schema._warn_first_order_removed.cache_clear()
    for _ in range(2):
        parameters = load_parameters({"fidelity.level": "first_order"})
    assert parameters.fidelity.level == "dynamic"
    (record,) = caplog.records
    assert record.getMessage() == (
        "fidelity.level: first_order no longer exists; dynamic is used instead, which is faster and more accurate"
    )


def test_a_law_that_breaks_the_contract_is_refused_by_its_name(
    monkeypatch,
):
    made = ContactLaw((Layer(stiffness=1e7), Layer(0.0, 0.0, 1e8)))
    monkeypatch.setitem(CONTACT_LAWS, "hertz", lambda *, stiffness, exponent: made)
    with pytest.raises(
        UsageError,
        match=r"parameter contact\.law: hertz: contact law: the first layer must begin at "
        "0 m and",
    ):
        knee_contact_ros.load_model({"contact.law": "hertz"})


def law_with_an_edge(
    *, stiffness: float, edge: Annotated[float, Range(0.0, 1.0, "[m] of it")] = 0.25
) -> ContactLaw:
    """A law with a constant of its own."""
    return CONTACT_LAWS["hertz"](stiffness=stiffness, exponent=1.0 + edge)


def test_a_constant_of_one_law_is_a_parameter():
    section = with_constants_of_laws({**CONTACT_LAWS, "edged": law_with_an_edge})
    assert set(section.model_fields) == {*ContactSection.model_fields, "edge"}
    assert section.model_fields["edge"].description == "[m] of it"
    assert section().model_dump() == {**ContactSection().model_dump(), "edge": 0.25}
    assert section(edge=1.0).model_dump()["edge"] == 1.0
    for bad in (-0.1, 1.1, "0.5", float("nan")):
        with pytest.raises(ValidationError, match="edge"):
            section(edge=bad)


def bits(knee):
    time = 0.002 * np.arange(6)
    return knee.run(time, 0.1 + time, 600.0 + 4e3 * time).tobytes()


def test_a_loaded_model_works_in_another_process():
    knee = knee_contact_ros.load_model(["osteoarthritis", "mri_femur"])
    with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as pool:
        assert pool.submit(bits, knee).result(120.0) == bits(knee)
    assert isinstance(copy.deepcopy(knee).run([0.0], [0.1], [700.0]), knee_contact_ros.Results)


def subject(folder, text):
    path = folder / "subject.yaml"
    path.write_text(text, encoding="utf-8")
    return path


def test_the_generic_model_is_the_papers(tmp_path):
    parameters = load_parameters(subject(tmp_path, "mass: 75.16\n"))
    assert parameters.body_weight == pytest.approx(
        737.068, abs=5e-4
    )  # as the parameter files round it
    assert parameters.femur.mass == pytest.approx(9.3014, rel=1e-12)
    scaled = load_parameters(subject(tmp_path, "mass: 72.6\n"))
    assert scaled.femur.mass == pytest.approx(
        8.984, abs=1e-3
    )  # OpenSim's own scaling of this model
    assert scaled.body_weight == pytest.approx(711.963, abs=1e-3)


def test_a_subject_file_sets_all_that_it_may(tmp_path, config):
    shutil.copy(config / "femur_medial.csv", tmp_path / "mine.csv")
    text = """
name: somebody
mass: 60
parameters: [osteoarthritis.yaml]
profile: mine.csv
tibial_profile: tibia_medial.csv
scale: 0.95
thickness: 0.0004
joint: knee_r
bag: gait
"""
    found = Subject(subject(tmp_path, text))
    (tmp_path / "gait").mkdir()
    parameters = load_parameters(found.path)
    assert found.bag == tmp_path / "gait"
    assert parameters.contact.law == "two_layer_viscoelastic"
    assert parameters.contact.layer_depth == 0.0004
    assert parameters.knee.joint_name == "knee_r"
    assert (parameters.femur.geometry, parameters.femur.profile) == (
        "profile",
        str(tmp_path / "mine.csv"),
    )
    assert parameters.tibia.profile == str(config / "tibia_medial.csv")
    assert (parameters.femur.scale, parameters.tibia.scale) == (0.95, 0.95)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", "not a subject file"),
        ("mass: [", "not a YAML file"),
        ("name: x\n", "mass: is missing"),
        ("mass: -3\n", "mass: -3 is not allowed; it should be greater than or equal to 1"),
        ("mass: 70\nthicknes: 1\n", "thicknes: is not known"),
        ("mass: 70\nparameters: []\n", "parameters: [] is not allowed"),
        ("mass: 70\nparameters: [none.yaml]\n", "none.yaml"),
    ],
)
def test_what_is_not_allowed_is_one_line(tmp_path, text, words):
    with pytest.raises(UsageError) as caught:
        load_parameters(Subject(subject(tmp_path, text)).path)
    assert words in str(caught.value)


def test_solve_takes_a_subject_and_reports_what_is_missing(right_bag, tmp_path, capsys):
    path = subject(
        tmp_path,
        f"mass: 72.6\nthickness: 0.0006\nparameters: [osteoarthritis.yaml]\nbag: {right_bag}\n",
    )
    values = ["-p", "contact.layer_depth:=0.0007", "--output", str(tmp_path / "out.mcap")]
    assert main(["solve", "--subject", str(path), *values, "-p", "contact.law:=hertz"]) == 2
    assert "thickness: 0.0006 is not used by contact.law hertz" in capsys.readouterr().err
    assert main(["solve", "--subject", str(path), *values]) == 0
    assert "2.27" in capsys.readouterr().out  # 1613.8 N in body weights of 711.96 N
    found = read_provenance(tmp_path / "out.mcap")
    assert found
    assert found.parameters.contact.layer_depth == 0.0007
    path = subject(tmp_path, "mass: 70\n")
    assert main(["solve", "--subject", str(path), "--output", str(tmp_path / "a.mcap")]) == 2
    assert "no BAG: give a BAG, or a --subject file that names one" in capsys.readouterr().err
    assert main(["solve", "--subject", "none.yaml", "--output", str(tmp_path / "a.mcap")]) == 2
    assert "none.yaml: cannot read the subject file" in capsys.readouterr().err


def test_a_subject_file_gives_every_door_the_same_knee(right_bag, tmp_path, monkeypatch):
    """The model, `solve`, a study, estimates of loads; `tests/ros/test_node.py` starts the node with one."""
    path = subject(
        tmp_path,
        f"mass: 72.6\nthickness: 0.0004\nparameters: [osteoarthritis]\nbag: {right_bag}\n",
    )
    gait = knee_contact_ros.solve(subject=path)
    depth = gait.penetration_depth.max()
    assert depth < 0.5e-3
    assert knee_contact_ros.solve(right_bag, str(path)).tobytes() == gait.tobytes()
    knee = knee_contact_ros.load_model(path)
    assert knee.run(gait.time, gait.flexion_angle, gait.load).penetration_depth.max() == depth
    assert knee_contact_ros.sweep(
        right_bag, {"load.share": [0.5]}, path
    ).outcomes.peak_depth.tolist() == [depth]
    study = Study(subjects=[str(path)])
    assert study.knees == [(str(right_bag), ("healthy", str(path)))]
    assert load_parameters(path, LoadParameters).person.mass == 72.6
    monkeypatch.chdir(tmp_path)
    assert load_parameters("subject") == load_parameters(path)
    # Named knees of a study, or of a later file, come to a subject that names none.
    alone = subject(tmp_path, "mass: 72.6\n")
    worn = load_parameters([alone, "osteoarthritis"])
    assert worn == load_parameters(["osteoarthritis", alone])
    assert worn.contact.layer_depth == 0.5e-3
    assert worn.femur.mass == pytest.approx(8.984, abs=1e-3)


@pytest.mark.parametrize(
    ("text", "study", "words"),
    [
        ("mass: 70\n", {}, "bag: is missing; a study needs its gait"),
        (
            "mass: 70\nbag: x\nparameters: [healthy]\n",
            {"params": ["healthy"]},
            "name the knees in one of both",
        ),
    ],
)
def test_a_study_says_what_a_subject_file_lacks(tmp_path, text, study, words):
    with pytest.raises(UsageError, match=words):
        Study(subjects=[str(subject(tmp_path, text))], **study)
    with pytest.raises(UsageError, match="needs bags, or subjects"):
        Study()


TYPED = {"contact.stiffness": 2500.0}
"""N/mm^1.5 for N/m^1.5"""
FIFTH = r"beyond 6\.8 mm, a fifth of the femoral radius"
HALF = r"under 368\.5 N \(0\.5 body weights\)"
MILLISECOND = 1_000_000


def doubts(**values):
    """Those about parameters, `__` standing for a dot."""
    parameters = load_parameters(
        {name.replace("__", "."): value for name, value in values.items()}
    )
    return doubts_about(parameters, build_model(parameters))


@pytest.mark.parametrize(
    ("source", "told"), [("/a exo_msgs/Knee deg_not_said", True), ("/a", False)]
)
def test_a_field_in_degrees_is_told_with_what_to_write(source, told):
    watched = doubts(knee__source=source)
    rows = np.zeros(200, ROW)
    rows["stamp"], rows["flexion_angle"] = np.arange(200) * 5 * MILLISECOND, np.arange(200) % 60
    rows["load"] = 500.0
    watched.add_answers(rows)
    (said,) = watched.about_inputs[:1]
    assert "degrees instead of radians" in said
    assert ("write deg behind the field of knee.source" in said) == told


def test_the_defaults_and_all_shipped_files_make_sense(config):
    combinations = [[], ["healthy.yaml"], ["osteoarthritis.yaml"]]
    combinations += [
        [*files, knee]
        for files in combinations[1:]
        for knee in ("mri_femur.yaml", "mri_knee.yaml")
    ]
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        for files in combinations:
            knee_contact_ros.load_model([config / name for name in files])
    for name in ("elastic_foundation", "two_layer_viscoelastic", "flores"):
        assert doubts(contact__law=name).sentences == []
    assert doubts(contact__stiffness_from="material").sentences == []


@pytest.mark.parametrize(
    ("values", "words"),
    [
        (
            TYPED,
            rf"^contact\.stiffness 2500 N/m\^1\.5 gives 279 mm of depth {HALF}, {FIFTH}; "
            r"2500 N/mm\^1\.5 would be 7\.905694e\+07 N/m\^1\.5$",
        ),
        (
            {"pairing.angle_delay": 0.12},
            r"^pairing\.wait 0\.1 s does not exceed pairing\.angle_delay 0\.12 s: live, the node answers every "
            r"force .* \(INPUT_HELD\)$",
        ),
        (TYPED | {"load.compartment": "total"}, r"under 737\.1 N \(1 body weights\), "),
        (TYPED | {"load.compartment": "moment_balance"}, HALF),
        (TYPED | {"load.share": 0.7}, r"under 515\.9 N \(0\.7 body weights\), "),
        (
            {"contact.law": "elastic_foundation", "contact.youngs_modulus": 24.0},
            rf"^contact\.youngs_modulus 24 Pa gives 466 mm of depth {HALF}, beyond 4\.4 mm, the cartilage's thickness; "
            r"24 MPa would be 2\.4e\+07 Pa$",
        ),
        (
            {"contact.stiffness_from": "material", "contact.youngs_modulus": 24.0},
            rf"^contact\.youngs_modulus 24 Pa gives 1\.94e\+04 mm of depth {HALF}, {FIFTH}; 24 MPa would",
        ),
        (
            {"contact.law": "two_layer_elastic", "contact.stiffness_2": 98408.0},
            r"^contact\.stiffness_2 98408 N/m\^1\.5 is below contact\.stiffness, 7\.905694e\+07: bone softer "
            r"than cartilage; 98408 N/mm\^1\.5 would be 3\.111934e\+09 N/m\^1\.5$",
        ),
        (
            {
                "contact.law": "two_layer_elastic",
                "contact.stiffness": 2500.0,
                "contact.stiffness_2": 98408.0,
            },
            r"^contact\.stiffness 2500 N/m\^1\.5 gives 24\.6 mm .*; 2500 N/mm\^1\.5 would be 7\.905694e\+07",
        ),
        (
            {"contact.damping": 5.0},
            r"^contact\.damping 5 N s/m hardly damps; 5 N s/mm would be 5000 N s/m$",
        ),
        (
            {"contact.layer_depth": 1e-3},
            r"^contact\.layer_depth has no effect under contact\.law kelvin_voigt$",
        ),
        (
            {"contact.law": "hertz", "contact.damping": 2e3, "contact.stiffness_2": 1e9},
            r"^contact\.damping, contact\.stiffness_2 have no effect under contact\.law hertz$",
        ),
        (
            {
                "contact.stiffness_from": "material",
                "contact.stiffness": 1e8,
                "contact.youngs_modulus": 9e8,
            },
            r"^contact\.stiffness has no effect under contact\.law kelvin_voigt with contact\.stiffness_from material$",
        ),
        (
            {"contact.law": "two_layer_elastic", "contact.layer_depth": 0.05},
            r"^contact\.layer_depth 0\.05 m is 50 mm, and bone is never reached, .*; 0\.05 cm would be 0\.0005 m$",
        ),
        (
            {"femur.mass": 68.0},
            r"^femur\.mass 68 kg is 90 % of the body's 75\.16 kg: is it the body's\? .* 12 %: 9\.3 kg$",
        ),
        ({"body_weight": 75.0}, r"^body_weight 75 N: is it kg\? 75 kg weigh 735\.5 N$"),
    ],
)
def test_parameters_in_another_unit_are_reported_in_a_sentence(values, words):
    with pytest.warns(UserWarning, match=words) as caught:
        knee_contact_ros.load_model(values)
    assert len(caught) == 1
    assert "\n" not in str(caught[0].message)
    assert caught[0].filename == __file__  # where the user called


def test_a_contact_beyond_the_plateau_is_reported():
    """Of a femur whose origin is at the hip."""
    nothing = dict.fromkeys(("flexion_angle", "penetration_depth", "gap"), np.zeros(4))
    watch = Doubts()
    watch.add_answers(
        nothing
        | {
            "stamp": np.arange(4),
            "load": np.ones(4),
            "penetration_depth": np.array([1e-4, 1e-4, 1e-4, 0.0]),
            "status": np.array([32, 32, 0, 0]),
            "contact_point_x": np.array([0.061, -0.5, 0.059, 0.061]),
        }
    )
    assert watch.sentences[0].startswith(
        "the contact is up to 500 mm ahead of the tibia's origin or behind it, outside"
    )
    assert "in 2 of 4 ticks (IMPLAUSIBLE)" in watch.sentences[0]
    assert (watch.too_deep, watch.flown) == (0, 0)


def test_solve_reports_it_on_the_terminal_and_in_its_table(right_bag, tmp_path, capsys):
    output = tmp_path / "out.mcap"
    arguments = [
        str(right_bag),
        "-p",
        "contact.stiffness:=2500",
        "-p",
        "body_weight:=75.16",
        "--output",
        str(output),
    ]
    assert main(["solve", *arguments]) == 0
    printed = capsys.readouterr()
    lines = printed.err.splitlines()
    assert [line.partition(" warning: ")[2].split()[0] for line in lines] == [
        "body_weight",
        "contact.stiffness",
        "387",
    ]
    assert lines[2].startswith(
        "knee-contact: warning: 387 of 387 ticks are up to 359 mm deep, beyond 6.8 mm, a fifth of"
    )
    assert "387 x IMPLAUSIBLE" in printed.out
    words = " ".join(printed.out.split())
    for line in lines:
        assert f"warning {line.partition(' warning: ')[2][:30]}" in words


def test_solve_marks_the_peaks_of_a_landing(tmp_path, capsys):
    loads = [-200.0 if 50 <= i < 60 else 900.0 for i in range(121)]
    thrown = make_bag(
        tmp_path / "thrown.mcap",
        [(i * 10 * MILLISECOND, 0.1, load) for i, load in enumerate(loads)],
    )
    assert main(["solve", str(thrown), "--output", str(tmp_path / "thrown_out.mcap")]) == 0
    printed = capsys.readouterr()
    assert "largest !" in printed.out
    assert "! from an answer that is IMPLAUSIBLE" in printed.out
    assert "mm above the tibia, beyond 10 mm:" in printed.err
