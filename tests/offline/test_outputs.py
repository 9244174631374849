"""What `solve` and `estimate_load` write, and which bags they refuse: nothing is left behind then."""

import shutil
from functools import partial
from pathlib import Path

import pytest

from knee_contact_ros.bags.bag import RawMessage
from knee_contact_ros.bags.recorder import BagWriter
from knee_contact_ros.parameters.files import load_parameters
from knee_contact_ros.parameters.load_schema import LoadParameters
from knee_contact_ros.streams.messages import JointState, encode_joint_state
from knee_contact_ros.system.errors import UsageError
from tests.helpers.offline import estimate_load, solve
from tests.helpers.walking import ANGLES, FORCE, walk, walking_bag
from tests.offline.test_solve import make_bag

WALK = walk()


def computed(way, bag, output, values=None, **how):
    if way == "solve":
        return solve(bag, values or {}, output, **how)
    return estimate_load(bag, load_parameters(values or {}, LoadParameters), output, **how)


@pytest.fixture(params=["solve", "estimate_load"])
def way(request):
    return str(request.param)


@pytest.fixture
def bag(way, right_bag, tmp_path):
    """A folder with a bag for this way."""
    if way == "solve":
        return Path(shutil.copytree(right_bag, tmp_path / "bag"))
    (tmp_path / "bag").mkdir()
    walking_bag(tmp_path / "bag" / "walk.mcap", WALK)
    return tmp_path / "bag"


def test_an_output_is_replaced_only_when_asked(way, bag, tmp_path):
    output = tmp_path / "out.mcap"
    output.write_text("precious")
    with pytest.raises(UsageError, match="exists already"):
        computed(way, bag, output)
    with pytest.raises(UsageError, match="no bag"):
        computed(way, tmp_path / "missing", output, overwrite=True)
    assert output.read_text() == "precious"
    computed(way, bag, output, overwrite=True)
    assert output.stat().st_size > 10_000


@pytest.mark.parametrize("place", ["itself", "a link", "a file of the folder"])
def test_the_input_is_never_replaced(place, way, bag, tmp_path):
    (file,) = bag.glob("*.mcap")
    (tmp_path / "link.mcap").symlink_to(file)
    before = file.read_bytes()
    output = tmp_path / "link.mcap" if place == "a link" else file
    with pytest.raises(UsageError, match="is the input"):
        computed(way, file if place == "itself" else bag, output, overwrite=True)
    assert file.read_bytes() == before


def only(topic):
    return [message for message in WALK if message.topic == topic]


def elbow():
    states = [
        JointState(m.log_time, "", ("elbow", "hip"), (0.1, 0.2), (), ()) for m in only(ANGLES)
    ]
    return [
        *[RawMessage(ANGLES, each.stamp, encode_joint_state(each)) for each in states],
        *only(FORCE),
    ]


def empty(folder, topic):
    with BagWriter(folder / "b.mcap") as bag:
        bag.add_topic(topic, "geometry_msgs/msg/WrenchStamped")
    return folder / "b.mcap"


def written(folder, content):
    (folder / "broken.mcap").write_bytes(content)
    return folder / "broken.mcap"


def rows(*samples, joint="knee"):
    return lambda folder: make_bag(folder / "a" / "b.mcap", list(samples), joint=joint)


def leg(messages):
    return lambda folder: walking_bag(folder / "b.mcap", messages)


MISSING = lambda folder: folder / "missing"  # noqa: E731
UNUSABLE = {
    "solve": [
        (MISSING, {}, "no bag at"),
        (lambda folder: folder, {}, "it has no usable metadata.yaml"),
        (rows((0, 0.1, 1.0), joint="elbow"), {}, "no joint 'knee'; it has elbow"),
        (rows((0, float("nan"), 1.0)), {}, "is nan"),
        (rows(), {}, "is empty: nothing came"),
        (partial(empty, topic="/imu"), {}, r"no topic /joint_states .* its topics: /imu"),
        (partial(empty, topic="/joint_states"), {}, "must be a sensor_msgs/msg/JointState"),
        (
            rows((0, 0.1, 1.0)),
            {"femur.geometry": "profile", "femur.profile": "no.csv"},
            r"cannot read no\.csv",
        ),
        *(
            (partial(written, content=content), {}, r"broken\.mcap")
            for content in (b"", b"not a bag", b"\x89MCAP0\r\n" + b"\x00" * 64)
        ),
    ],
    "estimate_load": [
        (MISSING, {}, "no bag at"),
        (leg([]), {}, "is empty: nothing came while it was written"),
        (leg(only(ANGLES)), {}, "topic /ground_reaction_force has no messages"),
        (
            leg(elbow()),
            {},
            r"joint_states has no joint 'knee'; it has elbow, hip \(parameter knee\.joint_name\)$",
        ),
        (
            leg(WALK),
            {"hip.joint_name": "hips"},
            r"no joint 'hips'; it has hip, knee, ankle \(parameter hip\.joint_na",
        ),
        (
            leg(WALK),
            {"knee.assisted": True},
            r"could be estimated \(240 x joint_missing, 240 x no_angle_before; .* gives no effort for joint 'knee'\)$",
        ),
        (
            leg(WALK),
            {"frame.ground": "lab"},
            r"\(240 x frame_unknown; .* 'plate', and no static transform leads to 'lab'\)$",
        ),
        (
            leg([*only(ANGLES)[100:], *only(FORCE)[:50]]),
            {},
            r"no joint reaction could be estimated \(50 x no_angle_before\)$",
        ),
    ],
}


@pytest.mark.parametrize(
    ("way", "make", "values", "words"),
    [(way, *case) for way, cases in UNUSABLE.items() for case in cases],
)
def test_bags_that_cannot_be_used_leave_nothing_behind(way, make, values, words, tmp_path):
    bag, output = make(tmp_path), tmp_path / "o" / "out.mcap"
    with pytest.raises(UsageError, match=words):
        computed(way, bag, output, values)
    assert not output.parent.exists() or list(output.parent.iterdir()) == []
