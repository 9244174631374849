"""A bag of a leg's sensors to joint reactions, offline: what is written, what goes on from there, what is refused."""

from pathlib import Path

import numpy as np
import pytest

import knee_contact_ros
from knee_contact_ros.bags.answers import read_answers, read_bag
from knee_contact_ros.bags.bag import Bag, RawMessage
from knee_contact_ros.bags.provenance import provenance_record, read_provenance
from knee_contact_ros.bags.recorder import REFUSED_SAMPLES, AnswerWriter, BagWriter, FileLimits
from knee_contact_ros.model.types import Status
from knee_contact_ros.offline.output import SOURCE_DAMAGE
from knee_contact_ros.parameters.build import build_model
from knee_contact_ros.parameters.files import load_parameters
from knee_contact_ros.parameters.load_schema import LoadParameters
from knee_contact_ros.streams.contact_pipeline import ContactPipeline
from knee_contact_ros.streams.load_pipeline import LoadPipeline
from knee_contact_ros.streams.messages import encode_wrench_stamped
from knee_contact_ros.streams.output import LOAD_PROVENANCE
from knee_contact_ros.streams.topics import LOAD_INPUTS, LOAD_RECORDED, MESSAGE_TYPES, types_of
from knee_contact_ros.system.errors import UsageError
from tests.helpers.answers import answers_to
from tests.helpers.bags import raw_messages
from tests.helpers.commands import run
from tests.helpers.offline import estimate_load, solve
from tests.helpers.walking import ANGLES, FORCE, MS, WHOLE_LEG, ground, walk, walking_bag
from tests.lab.opensim.storages import AXES, TIBIA, write_storage

ROUNDING = 1e-6
"""[N] what nanoseconds and one more muscle lag round"""
NET_MAP = """
time: {column: t}
angle: {column: a, unit: rad}
net_force: {column: f, unit: N}
net_moment: {column: m, unit: N*m}
body_weight: 737.07
"""
TYPES = types_of(LOAD_RECORDED)
INPUTS = types_of(LOAD_INPUTS)
REACTION, ESTIMATE = list(TYPES)[2:]
WALK = walk()


def estimate(bag, output, values=None, **how):
    return estimate_load(
        bag,
        load_parameters(WHOLE_LEG if values is None else values, LoadParameters),
        output,
        **how,
    )


def raw(path, types=TYPES):
    return raw_messages(path, types)


def metadata(path):
    with Bag(path) as bag:
        return dict(bag.metadata)


@pytest.fixture(scope="module")
def walking(tmp_path_factory):
    """A bag of a walking leg."""
    return walking_bag(tmp_path_factory.mktemp("walk") / "walk.mcap", WALK)


@pytest.fixture(scope="module")
def estimated(walking, tmp_path_factory):
    """What is made of it with all that it tells."""
    output = tmp_path_factory.mktemp("estimated") / "load.mcap"
    estimate(walking, output)
    return output


def test_the_recording_holds_inputs_and_estimates(walking, estimated):
    messages = raw(estimated)
    assert [sum(m.topic == topic for m in messages) for topic in TYPES] == [240] * 4
    assert [m for m in messages if m.topic in INPUTS] == raw(walking, INPUTS) == WALK
    pipeline, expected, told = (
        LoadPipeline(load_parameters(WHOLE_LEG, LoadParameters)),
        [],
        [],
    )
    for answer in answers_to(pipeline, WALK):
        for topic, stamp, data in answer.records()[-2:]:
            expected.append(RawMessage(f"/{topic}", stamp, data))
        told.append(answer.estimate)
    assert [m for m in messages if m.topic in (REACTION, ESTIMATE)] == expected
    summary = estimate(walking, None)
    assert summary.axial.tolist() == [each.axial_force for each in told]
    assert summary.stamps.tolist() == [
        message.log_time for message in WALK if message.topic == FORCE
    ]
    assert summary.peak == max(told, key=lambda each: each.axial_force)
    assert (summary.level, summary.calibrated) == ("ankle_moment", False)
    assert (summary.flagged, summary.refused, summary.damage, summary.implausible) == (
        {},
        {},
        [],
        [],
    )


def test_impossible_angles_are_reported_once(walking, capsys):
    output = walking.with_name("bent.mcap")
    bent = "--params load/inverse_dynamics -p knee.offset:=5.0"
    assert run(f"estimate-load {walking} {bent} --output {output}") == 0
    assert capsys.readouterr().err.count("does it have an offset (knee.offset, in rad)") == 1
    with pytest.warns(UserWarning, match=r"offset \(knee\.offset, in rad\)"):
        knee_contact_ros.estimate_load(walking, WHOLE_LEG, {"knee.offset": 5.0})


def test_the_recording_has_its_provenance(walking, estimated):
    said = metadata(estimated)[LOAD_PROVENANCE]
    assert (said["level"], said["source"], said["ticks_before"]) == (
        "ankle_moment",
        walking.name,
        "0",
    )
    assert '"ground.components": "full"' in said["parameters"]
    assert not any(word in said["parameters"] for word in ("record.", "diagnostics.", "autostart"))
    assert metadata(estimated)[REFUSED_SAMPLES] == {"total": "0"}
    assert read_provenance(estimated) is None  # it is none of a contact


def test_the_estimate_can_be_solved(estimated, tmp_path):
    summary = solve(estimated, {}, tmp_path / "contact.mcap")
    assert (summary.ticks, summary.refused.total(), summary.flagged.total()) == (240, 0, 0)
    kept = raw(tmp_path / "contact.mcap", {ANGLES: TYPES[ANGLES], REACTION: TYPES[REACTION]})
    assert kept == [m for m in raw(estimated) if m.topic in (ANGLES, REACTION)]
    rows, told = (
        read_answers(tmp_path / "contact.mcap", "/knee_contact"),
        read_bag(estimated, {ESTIMATE: TYPES[ESTIMATE]}),
    )
    deviation, axial = np.array(
        [(m.message.standard_deviation, m.message.axial_force) for m in told]
    ).T
    found, force = (
        build_model(load_parameters({})).uncertainty(rows, 0.5 * deviation),
        rows["contact_force"],
    )
    np.testing.assert_allclose(
        deviation * force / axial, found.contact_force, rtol=1e-9
    )  # as the reference says
    by_hand = found.contact_force * rows["penetration_depth"] / (1.5 * force)
    firm = (
        force > 3.0 * found.contact_force
    )  # by less an upper bound counts, or inertia and damping do
    np.testing.assert_allclose(by_hand[firm], found.penetration_depth[firm], rtol=0.15)


def test_a_net_load_by_arrays_file_field_and_opensim(walking, tmp_path, monkeypatch):
    """Moment and force of another level give its muscles, and so its force, if no floor follows the ground force."""
    monkeypatch.chdir(tmp_path)
    alone = {"person.co_contraction": 0.0, "person.expected_load": 0.0}
    by_hand = {"hip.joint_name": "hip", "ground.components": "full"}
    expected = knee_contact_ros.estimate_load(walking, by_hand, alone)
    time, knee = 1e-9 * expected.stamp, expected.flexion_angle
    force, moment = expected.resultant_force, expected.knee_moment
    given = {"time": time, "knee": knee, "net_force": force, "net_moment": moment}

    def close(found, within):
        assert (found.level == 3).all()
        np.testing.assert_allclose(found.axial_force, expected.axial_force, atol=within)

    close(knee_contact_ros.estimate_load(given, values=alone), ROUNDING)

    np.savetxt("net.csv", np.column_stack([*given.values()]), "%.9f", ",", header="t,a,f,m")
    Path("map.yaml").write_text(NET_MAP)
    assert run("import-csv net.csv --map map.yaml --output bag") == 0
    close(knee_contact_ros.estimate_load("bag", "load/net_load", alone), 1e-3)

    zero = np.zeros(len(time))
    columns = dict(zip(AXES, [zero, -force, *[zero] * 3, moment, *[zero] * 3], strict=True))
    named = {TIBIA.format("r") + axis: column for axis, column in columns.items()}
    write_storage(Path("jr.sto"), time, named, "no")
    write_storage(Path("q.sto"), time, {"knee_angle_r": knee}, "no")
    opensim = "import-opensim --kinematics q.sto --reactions jr.sto --side right --rate 0"
    assert run(f"{opensim} --angle-sign 1 --angle-unit rad --net --output walk") == 0
    close(knee_contact_ros.estimate_load("walk", "load/net_load", alone), 1e-3)

    fields = "geometry_msgs/WrenchStamped -wrench.force.y, wrench.torque.z"
    source = {"ground.source": f"net_load {fields}", "ground.components": "net"}
    close(knee_contact_ros.estimate_load("bag", source, alone), 1e-3)
    with pytest.raises(UsageError, match=r"takes net_load"):
        knee_contact_ros.estimate_load("bag")


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("unit: N*m", "unit: N*m, scale: 0.001", "the largest net moment"),
        ("unit: N}", "unit: kN}", "the peak of"),
        ("unit: N*m", "unit: N*m, sign: -1", "is it positive if they extend it"),
    ],
)
def test_an_unlikely_net_load_is_doubted(old, new, words, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    time = np.arange(240) * 0.005
    knee = 0.45 - 0.3 * np.cos(6.0 * time)
    force = 700.0 * np.clip(np.sin(6.0 * time + 0.5), 0.0, None)
    rows = np.column_stack([time, knee, force, 60.0 * knee])
    np.savetxt("net.csv", rows, "%.6f", ",", header="t,a,f,m")
    Path("map.yaml").write_text(NET_MAP)
    assert run("import-csv net.csv --map map.yaml --output bag") == 0
    Path("map.yaml").write_text(NET_MAP.replace(old, new))
    assert run("import-csv net.csv --map map.yaml --output other") == 2
    assert words in capsys.readouterr().err


def test_contacts_of_a_doubtful_load_are_flagged(tmp_path):
    """A foot that bears nothing throughout is no walk, from 3 s on; a ground that pulls is none at once."""
    loads, contact = tmp_path / "loads.mcap", tmp_path / "contact.mcap"
    for force, begins in ((0.0, 3 * 10**9), (-400.0, -1)):
        pulls = (
            ground(stamp)._replace(stamp=stamp, force=(0.0, force, 0.0))
            for stamp in range(0, 10**10, 5 * MS)
        )
        messages = [
            message._replace(data=encode_wrench_stamped(next(pulls)))
            if message.topic == FORCE
            else message
            for message in walk(700)
        ]
        summary = estimate(walking_bag(tmp_path / "still.mcap", messages), loads, overwrite=True)
        flagged = [stamp > begins for stamp in summary.stamps.tolist()]
        assert any(flagged)
        assert summary.flagged[
            Status.DOUBTFUL_LOAD.name if force == 0.0 else Status.IMPLAUSIBLE.name
        ] == sum(flagged)
        assert solve(loads, {}, contact, overwrite=True).ticks == 700
        rows = read_answers(contact, "/knee_contact")
        assert ((rows["status"] & Status.DOUBTFUL_LOAD) != 0).tolist() == flagged
        stream = ContactPipeline(load_parameters({}), compiled=False)
        inputs = raw(loads, {ANGLES: TYPES[ANGLES], REACTION: TYPES[REACTION]})
        assert [answer.messages[0] for answer in answers_to(stream, inputs)] == [
            m.data for m in raw(contact, {"/knee_contact": "knee_contact_ros/msg/KneeContact"})
        ]
        (tmp_path / "still.mcap").unlink()


def test_a_split_estimate_can_be_solved(tmp_path):
    """As the node writes it with `record.max_duration`; its later files go on with no contact's."""
    pipeline, folder = LoadPipeline(load_parameters({}, LoadParameters)), tmp_path / "parts"
    record = provenance_record(load_parameters({}, LoadParameters))
    with BagWriter(folder / "load.mcap", limits=FileLimits(duration=400 * MS)) as bag:
        writer = AnswerWriter(
            bag, record, {topic: f"/{topic}" for topic in LOAD_RECORDED}, LOAD_PROVENANCE
        )
        for answer in answers_to(pipeline, WALK):
            writer.write_answer(answer.records())
        writer.write_ending(pipeline.ending())
    assert len(list(folder.glob("*.mcap"))) == 3
    assert read_provenance(folder) is None
    assert run(f"solve {folder} --output {tmp_path}/contact.mcap") == 0
    assert (
        len(raw(tmp_path / "contact.mcap", {"/knee_contact": MESSAGE_TYPES["knee_contact"]}))
        == 240
    )
    assert len(raw(folder)) == 960
    estimate(folder, tmp_path / "again.mcap", {})
    assert raw(tmp_path / "again.mcap") == raw(folder)


def test_a_damaged_bag_is_read_as_far_as_it_can_be(walking, estimated, tmp_path, capsys):
    cut = tmp_path / "cut.mcap"
    long = walking_bag(tmp_path / "long.mcap", walk(3000, MS))
    cut.write_bytes(long.read_bytes()[: 2 * long.stat().st_size // 3])
    output = tmp_path / "out.mcap"
    how = "--params load/inverse_dynamics"
    assert run(f"estimate-load {cut} {how} --output {output}") == 1
    said = capsys.readouterr()
    assert said.err.splitlines()[-1].startswith(
        f"knee-contact: bag {cut} is damaged, and read as far as it can be: "
    )
    assert f"Bag: {output}" in said.out
    assert metadata(output)[SOURCE_DAMAGE]["source"] == "cut.mcap"
    whole, part = estimate(long, None), raw(output, {REACTION: TYPES[REACTION]})
    assert 1000 < len(part) < 3000
    assert [m.log_time for m in part] == whole.stamps[: len(part)].tolist()
