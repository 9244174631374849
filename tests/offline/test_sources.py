"""Inputs of other topics and types, by the path of a field: the answers of the plain bag, to the bit."""

import math
from functools import partial

import numpy as np
import pytest
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from knee_contact_ros.bags.bag import Bag
from knee_contact_ros.bags.provenance import read_provenance
from knee_contact_ros.parameters.files import load_parameters
from knee_contact_ros.parameters.load_schema import LoadParameters
from knee_contact_ros.parameters.sources import DYNAMIC_JOINT_STATE_TYPE
from knee_contact_ros.streams.frames import FORCE_TURNED, TF_MESSAGE, TF_STATIC
from knee_contact_ros.streams.topics import types_of
from knee_contact_ros.system.errors import UsageError
from tests.helpers.bags import Mcap, raw_messages
from tests.helpers.offline import solve

STEP = 5_000_000
STAMPS = [1_000_000_000 + i * STEP for i in range(60)]
DEGREES = [11.0 + 5.0 * math.sin(0.3 * i) for i in range(60)]
ANGLES = [math.pi / 180.0 * degrees for degrees in DEGREES]
KILONEWTONS = [0.9 + 0.4 * math.sin(0.4 * i) for i in range(60)]
STATE = (
    "std_msgs/Header header\nuint16 mode\nexo_msgs/Joint[] joints\nfloat64[3] force\ntime_or_not stamp_of_sensor\n"
).replace("time_or_not", "builtin_interfaces/Time")
VALUE = "control_msgs/msg/InterfaceValue"
OWN = {
    VALUE: "string[] interface_names\nfloat64[] values\n",
    DYNAMIC_JOINT_STATE_TYPE: "std_msgs/Header header\nstring[] joint_names\nInterfaceValue[] interface_values\n",
    "exo_msgs/msg/State": STATE,
    "exo_msgs/msg/Joint": "string name\nfloat32 angle_deg\nfloat64 angle\n",
}
"""Definitions that no package here has"""
STORE = get_typestore(Stores.ROS2_JAZZY)
for name, text in OWN.items():
    STORE.register(get_types_from_msg(text, name))


def message(kind, *values):
    """A message by its full name."""
    return STORE.types[kind](*values)


def head(stamp, frame=""):
    return message(
        "std_msgs/msg/Header", message("builtin_interfaces/msg/Time", *divmod(stamp, 10**9)), frame
    )


def vector(x, y, z):
    return message("geometry_msgs/msg/Vector3", x, y, z)


def joint_state(names, position):
    empty = np.array([])
    return lambda t, angle, load: message(
        "sensor_msgs/msg/JointState", head(t), names, np.array(position(angle)), empty, empty
    )


def wrench(stamp, x, y, z):
    both = message("geometry_msgs/msg/Wrench", vector(x, y, z), vector(0.0, 0.0, 0.0))
    return message("geometry_msgs/msg/WrenchStamped", head(stamp), both)


def state(stamp, angle, load):
    joints = [
        message("exo_msgs/msg/Joint", f"j{n}", 0.0, value) for n, value in enumerate((9.0, -angle))
    ]
    force = np.array([0.0, -load, 0.0])
    return message("exo_msgs/msg/State", head(stamp), 3, joints, force, head(stamp).stamp)


def dynamic(stamp, angle, _load, interface="position"):
    """As a joint state broadcaster writes it: a joint without a position before, and efforts beside positions."""
    values = [message(VALUE, ["effort"], np.array([3.0]))]
    values += [
        message(VALUE, ["velocity", interface], np.array([np.nan, at])) for at in (9.9, angle)
    ]
    return message(DYNAMIC_JOINT_STATE_TYPE, head(stamp), ["motor", "hip", "knee"], values)


def in_frame(frame, along):
    """Forces in a frame, in which `along` gives the vector of a load that presses."""

    def make(stamp, _angle, load):
        made = wrench(stamp, *along(-load))
        made.header.frame_id = frame
        return made

    return make


def bag_of(path, topics, order=slice(None)):
    """A bag of these topics, each with a type and what makes its messages."""
    mcap = Mcap(path)
    channels = {}
    for topic, (kind, _) in topics.items():
        definition = STORE.generate_msgdef(kind, ros_version=2)[0].encode()
        schema = mcap.writer.register_schema(name=kind, encoding="ros2msg", data=definition)
        channels[topic] = mcap.writer.register_channel(
            topic=topic, message_encoding="cdr", schema_id=schema
        )
    for stamp, angle, load in list(zip(STAMPS, ANGLES, KILONEWTONS, strict=True))[order]:
        for topic, (kind, make) in topics.items():
            data = bytes(STORE.serialize_cdr(make(stamp, angle, 1e3 * load), kind))
            mcap.writer.add_message(channels[topic], stamp, data, stamp)
    return mcap.close()


ANGLE = (
    "/joint_states",
    ("sensor_msgs/msg/JointState", joint_state(["knee"], lambda angle: [angle])),
)
FORCE = (
    "/joint_reaction_force",
    ("geometry_msgs/msg/WrenchStamped", lambda t, _, load: wrench(t, 0.0, -load, 0.0)),
)


def answers(path, topic="knee_contact"):
    return [one.data for one in raw_messages(path, types_of([topic]))]


@pytest.fixture(scope="module")
def plain(tmp_path_factory):
    """Answers to the usual messages."""
    folder = tmp_path_factory.mktemp("plain")
    solve(
        bag_of(folder / "bag.mcap", dict([ANGLE, FORCE])), load_parameters({}), folder / "out.mcap"
    )
    return answers(folder / "out.mcap")


FLOAT = "std_msgs/msg/Float64"
CASES = {
    "a vector's axis": (
        "joint_states",
        "/right_grf: geometry_msgs/Vector3Stamped: vector.z",
        dict(
            [
                ANGLE,
                (
                    "/right_grf",
                    (
                        "geometry_msgs/msg/Vector3Stamped",
                        lambda t, _, load: message(
                            "geometry_msgs/msg/Vector3Stamped", head(t), vector(5.0, 6.0, load)
                        ),
                    ),
                ),
            ]
        ),
    ),
    "three axes, each with its sign": (
        "joint_states",
        "/ft/wrench geometry_msgs/WrenchStamped wrench.force.x, -wrench.force.z, wrench.force.y",
        dict([ANGLE, ("/ft/wrench", (FORCE[1][0], lambda t, _, load: wrench(t, 0.0, 0.0, load)))]),
    ),
    "both in one message of a type that only the bag defines": (
        "/state exo_msgs/State -joints[1].angle rad",
        "/state exo_msgs/State force[1] -1",
        {"/state": ("exo_msgs/msg/State", state)},
    ),
    "a number without a stamp": (
        "/angle std_msgs/Float64 data on arrival",
        "joint_reaction_force",
        dict([("/angle", (FLOAT, lambda _, angle, __: message(FLOAT, angle))), FORCE]),
    ),
    "joint states whose stamps are 0": (
        "/harmony/joint_states on arrival",
        "/joint_reaction_force",
        dict(
            [
                ("/harmony/joint_states", (ANGLE[1][0], lambda t, *rest: ANGLE[1][1](0, *rest))),
                FORCE,
            ]
        ),
    ),
    "joint states of ros2_control": (
        "dynamic_joint_states",
        "joint_reaction_force",
        dict([("/dynamic_joint_states", (DYNAMIC_JOINT_STATE_TYPE, dynamic)), FORCE]),
    ),
    "a body with an id": (
        "/humans/bodies/*/joint_states",
        "joint_reaction_force",
        dict(
            [
                (
                    "/humans/bodies/ab12/joint_states",
                    (
                        ANGLE[1][0],
                        joint_state(["l_knee_ab12", "r_knee_ab12"], lambda angle: [9.0, angle]),
                    ),
                ),
                FORCE,
            ]
        ),
    ),
}


@pytest.mark.parametrize("case", CASES)
def test_answers_are_those_of_the_usual_messages(case, plain, tmp_path):
    angles, forces, topics = CASES[case]
    joint = "r_knee_*" if "*" in angles else "knee"
    how = load_parameters({"knee.source": angles, "load.source": forces, "knee.joint_name": joint})
    bag, out = bag_of(tmp_path / "bag.mcap", topics), tmp_path / "out.mcap"
    solve(bag, how, out)
    assert answers(out) == plain
    solve(out, how, tmp_path / "again.mcap")  # a recording holds what was made of the sources
    assert answers(tmp_path / "again.mcap") == plain


@pytest.mark.parametrize(
    "source", ["joint_states", "joint_states sensor_msgs/JointState position[0]"]
)
def test_one_huge_message_costs_itself_and_is_told(source, tmp_path):
    def make(size):
        usual, odd = (joint_state(["knee"], lambda a, n=n: [a] * n) for n in (1, size))
        return lambda t, *rest: odd(t, *rest) if t == STAMPS[30] else usual(t, *rest)

    found, how = {}, load_parameters({"knee.source": source})
    for size in (1, 40_000):
        topics = dict([(ANGLE[0], (ANGLE[1][0], make(size))), FORCE])
        summary = solve(bag_of(tmp_path / f"{size}.mcap", topics), how, tmp_path / f"{size}o.mcap")
        assert summary.refused == ({"too_large": 1} if size > 1 else {})
        found[size] = answers(tmp_path / f"{size}o.mcap")
    assert len(found[40_000]) == 60
    assert found[40_000][:30] == found[1][:30]
    solve(tmp_path / "40000o.mcap", how, tmp_path / "again.mcap")
    assert answers(tmp_path / "again.mcap")[:30] == found[1][:30]


def test_forces_in_other_frames(
    tmp_path,
):
    """The sensor's y lies along the tibia's x, its z along y, its x along z: exact in floating point."""
    stamped = STORE.types["geometry_msgs/msg/TransformStamped"]
    pose = message(
        "geometry_msgs/msg/Transform",
        vector(0.0, 0.0, 0.0),
        message("geometry_msgs/msg/Quaternion", *[0.5] * 4),
    )
    lies = lambda t, *_: message(TF_MESSAGE, [stamped(head(t, "tibia"), "sensor", pose)])  # noqa: E731
    changed = (
        in_frame("tibia", lambda down: (0.0, down, 0.0)),
        in_frame("x", lambda down: (0.0, down, 0.0)),
    )
    made = {}
    for name, force, values in (
        ("tibia", changed[0], {}),
        ("sensor", in_frame("sensor", lambda down: (down, 0.0, 0.0)), {"frame.tibia": "tibia"}),
        ("changes", lambda t, *rest: changed[t >= STAMPS[40]](t, *rest), {}),
        ("world", in_frame("world", lambda down: (0.0, down, 0.0)), {}),
    ):
        topics = dict([ANGLE, (FORCE[0], (FORCE[1][0], force)), (TF_STATIC, (TF_MESSAGE, lies))])
        made[name] = tmp_path / f"{name}.mcap"
        bag = bag_of(tmp_path / f"{name}_in.mcap", topics)
        summary = solve(bag, values, made[name])
        assert [text[:33] for text in summary.warnings] == (
            ["the forces are in frame 'world', "] if name == "world" else []
        )
        assert summary.refused == ({"frame_changed": 20} if name == "changes" else {})
    assert answers(made["sensor"]) == answers(made["tibia"])
    assert answers(made["changes"]) == answers(made["tibia"])[:40]
    moving = dict([ANGLE, (FORCE[0], (FORCE[1][0], in_frame("sensor", lambda _: (0.0,) * 3)))])
    bag = bag_of(tmp_path / "moving.mcap", {**moving, "/tf": (TF_MESSAGE, lies)})
    with pytest.raises(
        UsageError, match=r"60 x frame_unknown.* on /tf moves, and only /tf_static"
    ):
        solve(bag, {"frame.tibia": "tibia"}, None)
    with Bag(made["sensor"]) as bag:
        note = bag.first_metadata(FORCE_TURNED)
    assert (note["from"], note["to"]) == ("sensor", "tibia")
    recorded = read_provenance(made["sensor"])
    solve(recorded.recording, recorded, tmp_path / "again.mcap")  # it needs no transform any more
    assert answers(tmp_path / "again.mcap") == answers(made["tibia"])


@pytest.mark.parametrize(
    ("angles", "forces", "words"),
    [
        (
            "/state exo_msgs/State joints[1].speed",
            "",
            r"exo_msgs/msg/Joint has no field 'speed'; it has name",
        ),
        (
            "/state exo_msgs/State force deg",
            "",
            r"force of exo_msgs/msg/State is not a number: name an element, as force\[0\]",
        ),
        (
            "/state exo_msgs/State joints[1].name",
            "",
            r"joints\[1\].name of exo_msgs/msg/State is not a number",
        ),
        ("/state exo_msgs/State header[0]", "", r"\[0\] is not an element of a list"),
        (
            "/state exo_msgs/State joints[7].angle",
            "",
            r"60 x field_missing.*joints\[7\].angle: there are 2 elements",
        ),
        (
            "/state exo_msgs/Other angle",
            "",
            r"topic /state is a exo_msgs/msg/State; it must be a exo_msgs/msg/Other",
        ),
        (
            "/number std_msgs/Float64 data",
            "",
            r"knee.source: std_msgs/msg/Float64 has no header with a stamp",
        ),
        (
            "/state exo_msgs/State mode N",
            "",
            r"knee.source: '/state .* unit 'N' is not allowed; allowed: rad, deg",
        ),
        (
            "/state exo_msgs/State mode, mode",
            "",
            r"knee.source: 2 fields are not allowed; knee.joint_name need 1",
        ),
        (
            "/state",
            "/state exo_msgs/State mode deg",
            r"load.source: .* unit 'deg' is not allowed; allowed: N, kN",
        ),
        ("/state", "/state exo_msgs/State mode, mode", r"load.source: 2 fields are not allowed"),
        (
            "joint_reaction_force",
            "",
            r"knee.source: joint_reaction_force is also the topic of load.source",
        ),
        (
            "/nan std_msgs/Float64 data on arrival",
            "",
            r"60 x not_finite.*; /nan: position is nan",
        ),
        (
            "/state exo_msgs.State mode",
            "",
            r"knee.source: .* is not allowed; allowed: TOPIC, or TOPIC TYPE FIELD",
        ),
    ],
)
def test_sources_that_cannot_be_read_are_refused(angles, forces, words, tmp_path):
    values = {"/number": 0.1, "/nan": math.nan}
    numbers = {
        topic: ("std_msgs/msg/Float64", lambda *_, v=value: message("std_msgs/msg/Float64", v))
        for topic, value in values.items()
    }
    bag = bag_of(
        tmp_path / "bag.mcap",
        {"/state": ("exo_msgs/msg/State", state), **numbers, **dict([FORCE])},
    )
    how = {"knee.source": angles, "load.source": forces or "joint_reaction_force"}
    with pytest.raises(UsageError, match=words):
        solve(bag, how, None)


def test_joint_states_of_ros2_control_that_do_not_fit(tmp_path):
    for interface, source, words in (
        ("position", "joint_states", "-p knee.source:=dynamic_joint_states reads those"),
        (
            "encoder",
            "dynamic_joint_states",
            "joint 'knee' has no interface position; it has velocity, encoder",
        ),
    ):
        made = (DYNAMIC_JOINT_STATE_TYPE, partial(dynamic, interface=interface))
        bag = bag_of(
            tmp_path / f"{interface}.mcap", dict([("/dynamic_joint_states", made), FORCE])
        )
        with pytest.raises(UsageError, match=words):
            solve(bag, {"knee.source": source}, None)


def test_forces_that_need_more_numbers_are_refused():
    one = {"load.source": "/f geometry_msgs/Vector3Stamped vector.z"}
    with pytest.raises(
        UsageError, match=r"load.source: 1 fields are not allowed; moment_balance needs 6"
    ):
        load_parameters(one | {"load.compartment": "moment_balance"})
    with pytest.raises(
        UsageError, match=r"load.source: 1 fields are not allowed; frame.tibia needs 3"
    ):
        load_parameters(one | {"frame.tibia": "shank"})
    with pytest.raises(
        UsageError,
        match=r"ground.source: 1 fields are not allowed; ground.components full needs 6",
    ):
        load_parameters(
            {"ground.source": one["load.source"], "ground.components": "full"}, LoadParameters
        )

    with pytest.raises(
        UsageError, match=r"ground.source: 1 fields are not allowed; ground.components net needs 2"
    ):
        load_parameters(
            {"ground.source": one["load.source"], "ground.components": "net"}, LoadParameters
        )


def test_another_body_replaces_one_that_is_gone(tmp_path):
    """Two bodies at once: the first is followed, and the other one refused, until it is gone for pairing.max_gap."""
    mcap = Mcap(tmp_path / "bag.mcap")
    kind = "sensor_msgs/msg/JointState"
    bodies = {
        body: mcap.channel(f"/humans/bodies/{body}/joint_states", kind) for body in ("a", "b")
    }
    force = mcap.channel("/joint_reaction_force", "geometry_msgs/msg/WrenchStamped")
    for number in range(200):
        stamp = 10**9 + number * STEP
        for body, seen in (("a", number < 100), ("b", number >= 50)):
            state = joint_state([f"r_knee_{body}"], lambda angle: [angle])(
                stamp, 0.1 if body == "a" else 0.2, 0.0
            )
            if seen:
                mcap.writer.add_message(
                    bodies[body], stamp, bytes(STORE.serialize_cdr(state, kind)), stamp
                )
        data = bytes(
            STORE.serialize_cdr(wrench(stamp, 0.0, -700.0, 0.0), "geometry_msgs/msg/WrenchStamped")
        )
        mcap.writer.add_message(force, stamp, data, stamp)
    how = load_parameters("rep155")
    kept = []
    summary = solve(mcap.close(), how, None, keep=lambda block: kept.append(block.rows[0].copy()))
    angles = [angle for rows in kept for angle in rows["flexion_angle"]]
    gap = round(how.pairing.max_gap * 1e9 / STEP)
    assert angles[:100] == [0.1] * 100
    assert angles[-(100 - gap - 1) :] == [0.2] * (100 - gap - 1)
    assert summary.refused["another_body"] == 50 + gap
