"""Medial and lateral contact from one stream: each as if it were alone, and their wrenches added."""

from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import knee_contact_ros
from knee_contact_ros.bags.answers import read_bag
from knee_contact_ros.bags.provenance import read_provenance
from knee_contact_ros.model.laws import CONTACT_LAWS
from knee_contact_ros.model.types import FLAT, MAX_SURFACE_GAP, ROW, Status
from knee_contact_ros.parameters.build import build_model
from knee_contact_ros.parameters.files import load_parameters
from knee_contact_ros.parameters.schema import lateral_knee
from knee_contact_ros.streams.contact_pipeline import ContactPipeline
from knee_contact_ros.streams.messages import (
    WRENCH,
    JointState,
    WrenchStamped,
    encode_joint_state,
    encode_wrench_stamped,
)
from knee_contact_ros.streams.topics import recorded_topics, types_of
from tests.helpers.offline import solve
from tests.helpers.scenes import quick

STEP = 5_000_000
"""[ns]"""
TICKS = 60
BOTH = {"load.compartment": "both", "load.compartment_spacing": 0.05}
ROUNDINGS = 4 * np.finfo(float).eps
"""Relative, of a difference and a sum of numbers of one size"""


def messages(moment=0.0):
    """A stance and a half: joint states and forces."""
    for i in range(TICKS):
        angle, force = 0.4 + 0.4 * np.sin(0.1 * i), 700.0 - 800.0 * np.cos(0.2 * i)
        state = JointState(i * STEP, "", ("knee",), (angle,), (), ())
        yield (
            encode_joint_state(state),
            encode_wrench_stamped(
                WrenchStamped(i * STEP, "tibia_r", (0.0, -force, 0.0), (moment, 0.0, 0.0))
            ),
        )


def one_by_one(pipeline, moment=0.0):
    """All answers, and the rows of each compartment."""
    answers = []
    for state, force in messages(moment):
        answers += [*pipeline.push_joint_state(state), *pipeline.push_force(force)]
    answers += pipeline.finish_streams()
    rows = np.frombuffer(b"".join(row for answer in answers for row in answer.rows), ROW)
    number = len(pipeline.compartments)
    return answers, [rows[first::number] for first in range(number)]


def pipeline_of(values):
    return quick_pipeline([BOTH, values])


def quick_pipeline(sources):
    """Compiled, as the knees are many."""
    return ContactPipeline(load_parameters(sources), compiled=True)


def without_place(rows):
    """All numbers but those that tell where the compartment lies."""
    names = [
        name
        for name in FLAT.names or ()
        if name not in ("contact_point_z", "contact_wrench_torque_x", "contact_wrench_torque_y")
    ]
    return list(zip(*(rows.view(FLAT)[name].tolist() for name in names), strict=True))


KNEES: list[dict[str, Any]] = [
    *({"contact.law": law} for law in CONTACT_LAWS),
    {"lateral.contact.law": "two_layer_viscoelastic", "lateral.femur.radius": 0.028},
    {
        "lateral.tibia.geometry": "circle",
        "lateral.tibia.radius": 0.08,
        "lateral.contact.stiffness": 5e7,
    },
    {
        "femur.geometry": "profile",
        "femur.profile": "femur_medial.csv",
        "lateral.femur.profile": "femur_lateral.csv",
    },
    *({"fidelity.level": level} for level in ("quasi_static", "dynamic")),
    {
        "translation.mechanism": "parallel_mechanism",
        "tibia.slope": 0.1,
        "lateral.tibia.slope": -0.05,
    },
]


@pytest.mark.parametrize("values", KNEES, ids=str)
def test_each_compartment_answers_as_if_it_were_alone(values):
    """The medial one the same bits as with `fixed_share`; the lateral one those of its own model."""
    _, (medial, lateral) = one_by_one(pipeline_of(values | {"load.share": 0.6}))
    parameters = load_parameters([BOTH, values, {"load.share": 0.6}])
    _, (expected,) = one_by_one(quick_pipeline([values, {"load.share": 0.6}]))
    assert without_place(medial) == without_place(expected)
    own = lateral_knee(parameters)
    texts = {
        name: (Path(knee_contact_ros.__file__).parents[1] / "config" / file).read_text()
        for name, file in (("femur.profile", own.femur.profile),)
        if file
    }
    stream = quick(build_model(own, curves=texts)).stream()
    again = stream.advance_all(lateral["stamp"], lateral["flexion_angle"], lateral["load"], None)
    assert without_place(again) == without_place(lateral)


@settings(deadline=None, max_examples=25)
@given(
    share=st.floats(0.01, 1.0),
    moment=st.floats(-10.0, 10.0),
    split=st.sampled_from(["fixed_share", "moment_balance"]),
)
def test_medial_and_lateral_load_are_the_axial_load(share, moment, split):
    _, (medial, lateral) = one_by_one(
        pipeline_of({"load.share": share, "load.split": split, "fidelity.level": "quasi_static"}),
        moment,
    )
    axial = 700.0 - 800.0 * np.cos(0.2 * np.arange(TICKS))
    largest = np.maximum(np.abs(medial["load"]), np.abs(lateral["load"]))
    assert (
        np.abs(medial["load"] + lateral["load"] - axial)
        <= ROUNDINGS * np.maximum(largest, np.abs(axial))
    ).all()


def test_the_wrench_is_that_of_both_forces_at_the_origin():
    """On planes without slope the forces point down: their moment about x is d (lateral - medial)."""
    answers, (medial, lateral) = one_by_one(pipeline_of({"load.share": 0.7}))
    wrenches = [WRENCH.decode_message(answer.wrench)[0] for answer in answers]
    total = medial["contact_force"] + lateral["contact_force"]
    assert [wrench.force[1] for wrench in wrenches if wrench] == pytest.approx(
        (-total).tolist(), rel=ROUNDINGS
    )
    moment = 0.025 * (lateral["contact_force"] - medial["contact_force"])
    found = [wrench.torque[0] for wrench in wrenches if wrench]
    assert found == pytest.approx(moment.tolist(), abs=ROUNDINGS * 0.025 * float(total.max()))
    assert set(medial["contact_point"]["z"]) == {-0.025}
    assert set(lateral["contact_point"]["z"]) == {0.025}


def test_a_recording_that_begins_in_motion_is_unknown_at_first():
    """Of a node that had answered before; what it had computed until then is not known."""
    pipeline = quick_pipeline([])
    pipeline.resume_recording(ticks_before=1)
    _, (rows,) = one_by_one(pipeline)
    unknown = rows["status"] & Status.NOT_CONVERGED != 0
    assert unknown[0]
    assert rows["error_estimate"][0] == pipeline.model.plausible_depth + MAX_SURFACE_GAP


def test_a_recording_of_both_is_computed_again_from_itself(right_bag, tmp_path):
    types = types_of(recorded_topics(has_both=True))
    parameters = load_parameters(
        ["healthy", "both_compartments", {"lateral.contact.damping": 900.0}]
    )
    summary = solve(right_bag, parameters, tmp_path / "one.mcap", compiled=True)
    assert summary.lateral is not None
    assert summary.lateral.ticks == summary.ticks == 387
    provenance = read_provenance(tmp_path / "one.mcap")
    assert provenance is not None
    assert provenance.parameters == parameters
    solve(
        tmp_path / "one.mcap",
        provenance,
        tmp_path / "two.mcap",
        compiled=True,
    )
    one, two = (
        [(m.topic, m.log_time, str(m.message)) for m in read_bag(tmp_path / name, types)]
        for name in ("one.mcap", "two.mcap")
    )
    assert one == two
    assert Counter(topic for topic, *_ in one) == dict.fromkeys(types, 387) | {
        "/robot_description": 1,
        "/tf": 98,
    }


@pytest.mark.parametrize(
    ("parameters", "words"),
    [
        ({}, "force.y < 0 in joint_reaction_force"),
        ({"load.source": "/cell std_msgs/msg/Float64 data"}, "data > 0 in /cell"),
        (
            {"load.source": "/ft geometry_msgs/msg/WrenchStamped -wrench.force.z"},
            "wrench.force.z < 0 in /ft",
        ),
        (
            {"load.source": "/ft", "load.rotation": "90 0 0 deg"},
            "force.y < 0 in /ft after load.rotation '90 0 0 deg'",
        ),
    ],
)
def test_a_load_that_pulls_names_the_field_of_the_user(parameters, words):
    pipeline = ContactPipeline(load_parameters(parameters), compiled=False)
    inputs = pipeline.doubts.inputs
    stamps = np.arange(400) * 10_000_000
    inputs.add_samples(stamps, np.full(400, 0.3), np.linspace(-900.0, -100.0, 400))
    assert f"compression is {words}; does your sensor" in inputs.about_load
