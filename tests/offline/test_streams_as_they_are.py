"""Bags as people's recorders leave them: clocks that are set back, files that overlap, messages written late."""

import re
import shutil

import numpy as np
import pytest
from rosbags.rosbag2 import StoragePlugin

import knee_contact_ros
from knee_contact_ros.bags.answers import read_answers
from knee_contact_ros.bags.bag import RawMessage
from knee_contact_ros.bags.leg import DrawnLeg
from knee_contact_ros.bags.provenance import provenance_record
from knee_contact_ros.bags.recorder import AnswerWriter, BagWriter
from knee_contact_ros.model.types import Status
from knee_contact_ros.parameters.files import load_parameters
from knee_contact_ros.streams.contact_pipeline import ContactPipeline
from knee_contact_ros.streams.messages import (
    WRENCH,
    decode_joint_state,
    encode_joint_state,
    encode_wrench_stamped,
)
from knee_contact_ros.streams.topics import JOINT_STATES, KNEE_CONTACT, MESSAGE_TYPES, typestore
from tests.helpers.answers import answers_to
from tests.helpers.bags import Mcap, raw_messages, write_rosbag2
from tests.helpers.commands import run
from tests.helpers.offline import solve

MOMENT = 600
"""Index of the message before which something happens: in stance"""


@pytest.fixture(scope="module")
def gait(right_bag):
    return raw_messages(right_bag)


def moved(message, by, log_by=None):
    """A message with another stamp, and another log time if that is not moved likewise."""
    seconds, nanoseconds = divmod(
        int.from_bytes(message.data[4:8], "little") * 10**9
        + int.from_bytes(message.data[8:12], "little")
        + by,
        10**9,
    )
    stamp = seconds.to_bytes(4, "little", signed=True) + nanoseconds.to_bytes(4, "little")
    data = message.data[:4] + stamp + message.data[12:]
    return RawMessage(message.topic, message.log_time + (by if log_by is None else log_by), data)


def mcap(path, messages):
    """A file of small chunks, with the messages in this order."""
    file = Mcap(path)
    channels = file.channels()
    for message in messages:
        file.write(channels[message.topic], message)
    return file.close()


def live(messages, path=None):
    """The answers to messages in the order of their arrival; with a `path`, the recording of them is there."""
    parameters = load_parameters({})
    pipeline = ContactPipeline(parameters, compiled=False)
    answers = [*answers_to(pipeline, messages), *pipeline.finish_streams()]
    if path:
        with BagWriter(path) as bag:
            writer = AnswerWriter(bag, provenance_record(parameters, {}))
            leg = DrawnLeg()
            for answer in answers:
                writer.write_answer(leg.records_with_leg(answer))
            writer.write_ending(pipeline.ending())
    return [answer.messages[0] for answer in answers]


def split(folder, parts):
    """A folder of numbered files, as when `metadata.yaml` was lost."""
    folder.mkdir()
    for number, part in enumerate(parts):
        mcap(folder / f"bag_{number}.mcap", part)
    return folder


def solved(bag, tmp_path):
    solve(bag, {}, tmp_path / "out.mcap", overwrite=True, compiled=False)
    topic = f"/{KNEE_CONTACT}"
    messages = raw_messages(tmp_path / "out.mcap", {topic: MESSAGE_TYPES[KNEE_CONTACT]})
    return [message.data for message in messages]


FORMS = {
    "file": lambda folder, messages: mcap(folder / "in.mcap", messages),
    "sqlite3": lambda folder, messages: write_rosbag2(
        folder / "in", messages, StoragePlugin.SQLITE3
    ),
    "split": lambda folder, messages: split(folder / "in", [messages[:MOMENT], messages[MOMENT:]]),
}
"""Ways of writing messages in their order"""


SET_BACK = [
    ("", 7_000_000, 0),
    ("", 602_500_000, 1),
    ("", 10**12, 1),
    ("states", 700_000_000, 0),
    ("force", 700_000_000, 1),
]
"""Topic whose clock is set back, by how much [ns], and how many runs begin by that"""


@pytest.mark.parametrize(
    ("form", "of", "back", "resets"),
    [
        *((form, *back) for form in ("file", "recording") for back in SET_BACK),
        *((form, *SET_BACK[1]) for form in ("sqlite3", "split")),
    ],
)
def test_a_clock_that_is_set_back_begins_a_run_as_live(gait, tmp_path, form, of, back, resets):
    """The clock of all topics, or of one, is set back: by a sample, within and beyond what was recorded."""
    later = [moved(message, 2 * 10**12) for message in gait]
    messages = [
        moved(each, -back) if i >= MOMENT and of in each.topic else each
        for i, each in enumerate(later)
    ]
    recording = tmp_path / "recording.mcap"
    expected = live(messages, recording)
    bag = recording if form == "recording" else FORMS[form](tmp_path, messages)
    assert solved(bag, tmp_path) == expected or (form, resets) == (
        "recording",
        0,
    )  # it has no refused samples
    status = read_answers(tmp_path / "out.mcap")["status"]
    assert (len(status), np.count_nonzero(status & Status.TIME_RESET)) == (len(expected), resets)


def test_runs_of_a_recording_keep_their_order(gait, tmp_path):
    recording = tmp_path / "recording.mcap"
    expected = live(
        [moved(message, at * 10**9) for at in (0, 100, 50) for message in gait], recording
    )
    assert solved(recording, tmp_path) == expected
    assert [np.count_nonzero(read_answers(recording)["status"] == flag) for flag in (2, 1)] == [
        1,
        1,
    ]


def test_a_loop_has_a_run_for_each_round(gait, tmp_path, capsys):
    recording = tmp_path / "loop.mcap"
    once = len(live([*gait, *gait, *gait], recording)) // 3
    assert run(f"solve {recording} --output {tmp_path}/out.mcap") == 0
    out, err = capsys.readouterr()
    assert (
        "the answers are of 3 runs: each begins at rest (TIME_RESET), where stamps went back"
        in err
    )
    assert f"{3 * once} in {3 * 1.93:.2f} s in 3 runs" in out
    rows = [line.split() for line in out.splitlines() if line.startswith(" peak")]
    assert [row[-1] for row in rows] == ["1"] * 4 + ["2"] * 4 + ["3"] * 4
    assert len({tuple(row[2:-1]) for row in rows}) == 4


def test_the_runs_have_a_column(gait, tmp_path):
    pytest.importorskip("pandas")
    with pytest.warns(UserWarning, match="the answers are of 2 runs"):
        results = knee_contact_ros.solve(mcap(tmp_path / "twice.mcap", [*gait, *gait]))
    assert results.run.tolist() == results.to_pandas()["run"].tolist() == [0] * 387 + [1] * 387
    assert "774 ticks over 3.860 s in 2 runs" in repr(results)


LATE = slice(MOMENT, MOMENT + 30)


def without(messages, part):
    return messages[: part.start] + messages[part.stop :]


def by_topic(messages):
    topics = sorted({message.topic for message in messages})
    return [[message for message in messages if message.topic == topic] for topic in topics]


def shuffled(messages):
    """Messages of which many groups of five neighbours lie in any order, groups upon groups."""
    random, found = np.random.default_rng(60), list(messages)
    for begin in random.integers(0, len(found) - 5, 200).tolist():
        found[begin : begin + 5] = [found[begin + i] for i in random.permutation(5)]
    return found


def jittered(messages):
    """Messages whose log times are off by up to 40 % of a step."""
    random = np.random.default_rng(63)
    return [
        message._replace(log_time=message.log_time + round(random.uniform(-0.4, 0.4) * 5e6))
        for message in messages
    ]


UNORDERED = {
    "30 messages in the next file": lambda g: [without(g[:650], LATE), [*g[LATE], *g[650:]]],
    "30 messages in the file before": lambda g: [
        [*g[: LATE.start], *g[700:730]],
        [*g[LATE.start : 700], *g[730:]],
    ],
    "30 messages late in a file": lambda g: [[*without(g[:650], LATE), *g[LATE], *g[650:]]],
    "one message late in a file": lambda g: [
        [*g[:MOMENT], *g[MOMENT + 1 : MOMENT + 9], g[MOMENT], *g[MOMENT + 9 :]]
    ],
    "a file per topic": by_topic,
    "a topic behind the other": lambda g: [[*by_topic(g)[0], *by_topic(g)[1]]],
    "backwards": lambda g: [g[::-1]],
    "log times with a jitter": lambda g: [jittered(g)],
    "neighbours in any order": lambda g: [shuffled(g)],
}


@pytest.mark.parametrize("case", UNORDERED)
def test_late_messages_are_read_in_order(gait, tmp_path, case):
    bag = split(tmp_path / "in", UNORDERED[case](gait))
    assert solved(bag, tmp_path) == live(gait)


def states(g, change, every=1, later=0):
    """Joint states of a gait, changed; every n-th one, at later log times."""
    found = []
    for message in [message for message in g if message.topic == f"/{JOINT_STATES}"][::every]:
        content = decode_joint_state(message.data)
        data = encode_joint_state(change(content._replace(stamp=content.stamp + later)))
        found.append(RawMessage(message.topic, message.log_time + later, data))
    return found


def forces(g, later=0):
    return [moved(message, later) for message in g if message.topic != f"/{JOINT_STATES}"]


def in_order(*messages):
    return sorted(
        (message for each in messages for message in each), key=lambda message: message.log_time
    )


def two_channels(path, g, still):
    """The joint comes from two channels: as it is, and every fifth time 1 ms later as if it stood still."""
    each = (
        states(g, lambda one: one),
        states(g, lambda one: one._replace(position=(still,)), 5, 1_000_000),
    )
    file = Mcap(path)
    kinds = (JOINT_STATES, JOINT_STATES, "joint_reaction_force")
    channels = [file.channel(f"/{kind}", MESSAGE_TYPES[kind]) for kind in kinds]
    all_of_them = [
        (i, message) for i, part in enumerate((*each, forces(g, 2_000_000))) for message in part
    ]
    for number, message in sorted(all_of_them, key=lambda one: one[1].log_time):
        file.write(channels[number], message)
    return file.close()


def own_definition(path, g):
    """A file whose definition of JointState has a field more; its data do not matter."""
    file = Mcap(path)
    text = typestore().generate_msgdef("sensor_msgs/msg/JointState", ros_version=2)[0]
    text = text.replace("float64[] position", "float64[] setpoint\nfloat64[] position")
    schema = file.writer.register_schema("sensor_msgs/msg/JointState", "ros2msg", text.encode())
    channels = file.channels()
    channels[f"/{JOINT_STATES}"] = file.writer.register_channel(f"/{JOINT_STATES}", "cdr", schema)
    for message in g:
        file.write(channels[message.topic], message)
    return file.close()


def framed(g, frame):
    found = []
    for number, message in enumerate(forces(g)):
        wrench, _ = WRENCH.read_message(message.data, "")
        found.append(
            message._replace(data=encode_wrench_stamped(wrench._replace(frame_id=frame(number))))
        )
    return found


def later(g, by):
    """Forces with stamps that are later [ns]."""
    each = [(message, WRENCH.read_message(message.data, "")[0]) for message in forces(g)]
    return [
        message._replace(data=encode_wrench_stamped(one._replace(stamp=one.stamp + by)))
        for message, one in each
    ]


def unmerged(path, g):
    """A sqlite3 file whose recorder was killed: all is in the log beside it."""
    write_rosbag2(path.with_suffix(""), g, StoragePlugin.SQLITE3)
    (written,) = path.with_suffix("").glob("*.db3")
    path.write_bytes(b"")
    shutil.copy(written, path.with_name(f"{path.name}-wal"))
    return path


def of_bytes(content):
    def made(path, _):
        path.write_bytes(content)
        return path

    return made


HIP = ("hip", "knee", "ankle")
TOLD = {
    "two publishers": (
        lambda p, g: two_channels(p, g, 0.0),
        0,
        "knee.*channels 1 and 2 of the bag send it and dis",
    ),
    "a position less than names": (
        lambda p, g: mcap(
            p,
            in_order(
                states(g, lambda one: one._replace(name=HIP, position=(0.1, 0.2))), forces(g)
            ),
        ),
        2,
        "387 x lengths_differ.*3 names and 2 values of position: it is not clear which value",
    ),
    "another definition": (
        own_definition,
        2,
        "JointState differently from ROS 2.*setpoint where position should be",
    ),
    "stamps that were never set": (
        lambda p, g: mcap(p, [m._replace(data=m.data[:4] + bytes(8) + m.data[12:]) for m in g]),
        1,
        r"386 of 387 forces have no answer .*header\.stamp is not set \(0\)",
    ),
    "angle stamps that were never set": (
        lambda p, g: mcap(p, in_order(states(g, lambda one: one._replace(stamp=0)), forces(g))),
        0,
        r"387 of 387 answers .* hold an old angle of joint_states .*header\.stamp is not set \(0\)",
    ),
    "angle stamps from boot": (
        lambda p, g: mcap(p, in_order(states(g, lambda one: one), later(g, 10**18))),
        0,
        r"387 of 387 answers .* hold an old angle of .*: their stamps lie 1e\+09 s apart: .* from boot\?",
    ),
    "frames of two sensors": (
        lambda p, g: mcap(
            p, in_order(states(g, lambda one: one), framed(g, lambda n: f"sensor_{n % 2}"))
        ),
        1,
        "193 of 387 forces have no answer .*keep one frame_id",
    ),
    "angles that end early": (
        lambda p, g: mcap(p, in_order(states(g, lambda one: one)[300:], forces(g))),
        1,
        "300 of 387 forces have no answer .*there are no angles at their times",
    ),
    "degrees at first": (
        lambda p, g: mcap(
            p,
            in_order(
                states(g, lambda one: one._replace(position=(57.3,)))[:300],
                states(g, lambda one: one)[300:],
                forces(g),
            ),
        ),
        1,
        r"300 of 387 forces have no answer \(300 x out_of_range.*position\[0\] deg",
    ),
    "ROS 1": (of_bytes(b"#ROSBAG V2.0\n"), 2, "a bag of ROS 1.*rosbags-convert"),
    "compressed": (
        of_bytes(bytes.fromhex("28b52ffd") + bytes(100)),
        2,
        "is compressed: give the folder",
    ),
    "Git LFS": (of_bytes(b"version https://git-lfs.github.com/spec/v1\n"), 2, "git lfs pull"),
    "a log beside": (
        lambda p, g: unmerged(p.with_suffix(".db3"), g),
        2,
        r"in\.db3-wal holds messages",
    ),
}


@pytest.mark.parametrize("case", TOLD)
def test_faults_of_a_bag_are_reported_in_one_line(gait, tmp_path, capsys, case):
    make, code, words = TOLD[case]
    bag = make(tmp_path / "in.mcap", gait)
    assert run(f"solve {bag} --output {tmp_path}/out.mcap") == code
    assert re.search(words, capsys.readouterr().err)


@pytest.mark.parametrize("case", ["publishers that agree", "no frame at first"])
def test_no_report_without_a_fault(gait, tmp_path, capsys, case):
    angles = states(gait, lambda one: one)
    if case == "publishers that agree":
        messages = in_order(
            angles, states(gait, lambda one: one, 1, 1_000_000), forces(gait, 2_000_000)
        )
    else:
        messages = in_order(angles, framed(gait, lambda number: "tibia_r" if number else ""))
    bag = mcap(tmp_path / "in.mcap", messages)
    assert run(f"solve {bag} --output {tmp_path}/out.mcap") == 0
    assert not capsys.readouterr().err
    assert len(read_answers(tmp_path / "out.mcap")) == 387
