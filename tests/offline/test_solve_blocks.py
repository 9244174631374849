"""Block by block is as one by one: the same file to the last byte, whatever is in the bag."""

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from knee_contact_ros.bags.bag import INPUT_TYPES
from knee_contact_ros.bags.recorder import BagWriter
from knee_contact_ros.offline import solve as solve_module
from knee_contact_ros.offline.solve import SolveRun
from knee_contact_ros.offline.summary import Summary
from knee_contact_ros.parameters.files import load_parameters
from knee_contact_ros.streams.messages import (
    JOINT_STATE,
    JointState,
    WrenchStamped,
    encode_joint_state,
    encode_wrench_stamped,
)
from knee_contact_ros.system.errors import UsageError
from tests.helpers.bags import raw_messages
from tests.helpers.offline import solve

MILLISECOND = 1_000_000


def angle(stamp, value, names=("hip", "knee"), frame=""):
    positions = tuple(value if name == "knee" else 0.5 for name in names)
    return (
        "/joint_states",
        stamp,
        encode_joint_state(JointState(stamp, frame, names, positions, positions, ())),
    )


def force(stamp, axial, frame="tibia_r"):
    wrench = WrenchStamped(stamp, frame, (1.0, -axial, 2.0), (3.0, 4.0, 5.0))
    return "/joint_reaction_force", stamp, encode_wrench_stamped(wrench)


def gait(ticks, every=1, begin=0):
    """Forces each millisecond, an angle at every so manieth and half a millisecond off."""
    rows = []
    for i in range(begin, begin + ticks):
        stamp = i * MILLISECOND
        if i % every == 0:
            rows.append(
                angle(stamp - (MILLISECOND // 2 if every > 1 else 0), 0.3 + 0.2 * np.sin(0.02 * i))
            )
        rows.append(force(stamp, 800.0 + 700.0 * np.sin(0.05 * i)))
    return [row for row in rows if row[1] >= 0]


def write(path, messages):
    with BagWriter(path, overwrite=True) as bag:
        for topic, name in INPUT_TYPES.items():
            bag.add_topic(topic, name)
        for number, (topic, _, data) in enumerate(messages):
            bag.write_message(topic, number, data)  # log time is the order in which they came
    return path


def outcome(bag, parameters, output):
    """The summary, or why there is none."""
    output.unlink(missing_ok=True)
    try:
        return solve(bag, parameters, output, compiled=True)
    except UsageError as error:
        return str(error)


def taken_at_once(folder, messages, parameters, block):
    """How many blocks were taken at once; the outcome is the same as one by one, and so is the file."""
    bag, taken = write(folder / "bag.mcap", messages), []
    at_once = SolveRun._solve_at_once

    def counted(run, rows):  # type: ignore[type-arg]
        taken.append(at_once(run, rows))
        return taken[-1]

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(solve_module, "BATCH_SIZE", block)
        patch.setattr(SolveRun, "_solve_at_once", counted)
        first = outcome(bag, parameters, folder / "blocks" / "out.mcap")
        patch.setattr(SolveRun, "_solve_at_once", lambda _run, _rows: False)
        other = outcome(bag, parameters, folder / "single" / "out.mcap")
    assert first == other
    files = [
        path.read_bytes()
        for way in ("blocks", "single")
        if (path := folder / way / "out.mcap").exists()
    ]
    assert len(files) == 2 * isinstance(first, Summary)
    assert len(set(files)) <= 1
    return sum(taken)


PARAMETERS = {
    "plain": {},
    "two layers": {"contact.law": "two_layer_elastic", "load.compartment": "total"},
    "signed": {"knee.flexion_sign": -1.0, "knee.flexion_offset": 0.7, "pairing.max_gap": 0.005},
    "slope": {"tibia.slope": 0.1, "fidelity.level": "dynamic"},
    "late": {"pairing.angle_delay": 0.0253},
    "early": {"pairing.angle_delay": -0.0047, "pairing.max_gap": 0.005},
    "moment": {"load.compartment": "moment_balance", "load.compartment_spacing": 0.05},
    "tared": {"load.offset": -40.0, "load.compartment": "moment_balance"},
    "measured": {"load.compartment": "measured_share"},
}


@pytest.mark.parametrize("name", PARAMETERS)
@pytest.mark.parametrize("every", [1, 7])
def test_ordinary_bags_go_by_the_block(tmp_path, name, every):
    taken = taken_at_once(tmp_path, gait(600, every), load_parameters(PARAMETERS[name]), 200)
    assert taken >= 600 * (every + 1) // every // 200 - 1


@pytest.mark.parametrize("delay", [25 * MILLISECOND, -25 * MILLISECOND])
def test_a_known_delay_of_the_angles_changes_no_bit(tmp_path, delay):
    prompt, late, rows = (
        gait(400, 5, begin=1000),
        [],
        [[], []],
    )
    for topic, stamp, data in prompt:
        found = JOINT_STATE.decode_message(data) if topic == "/joint_states" else None
        late.append(
            (topic, stamp + delay, encode_joint_state(found[0]._replace(stamp=stamp + delay)))
            if found
            else (topic, stamp, data)
        )
    late.sort(key=lambda row: row[1])
    for kept, messages, seconds in zip(rows, (prompt, late), (0.0, 1e-9 * delay), strict=True):
        bag, output = write(tmp_path / "bag.mcap", messages), tmp_path / "out.mcap"
        parameters = load_parameters({"pairing.angle_delay": seconds})
        summary = solve(bag, parameters, output, overwrite=True, keep=kept.append)
        assert (summary.ticks, summary.refused.total(), summary.flagged["STALE_INPUT"]) == (
            400,
            0,
            0,
        )
        # As they came, under the stamps they came with.
        assert [(m.topic, m.log_time, m.data) for m in raw_messages(output)] == messages
    first, other = (b"".join(block.rows[0].tobytes() for block in blocks) for blocks in rows)
    assert first == other


def test_prescribed_heights(tmp_path):
    names, rows = ("knee_height", "knee"), []
    for i in range(300):
        state = JointState(
            i * MILLISECOND, "", names, (0.0335 + 1e-4 * np.sin(0.1 * i), 0.3), (), ()
        )
        rows += [
            ("/joint_states", state.stamp, encode_joint_state(state)),
            force(state.stamp, 500.0),
        ]
    assert taken_at_once(tmp_path, rows, load_parameters({"drive": "displacement"}), 100) == 6


def test_bytes_of_padding_do_not_matter(tmp_path):
    """ROS's own serialiser leaves them, and surplus bytes at the end."""
    rows, random = [], np.random.default_rng(5)
    for topic, stamp, data in gait(200):
        at = (
            data.find(b"knee\0") + 5
        )  # behind it come 3 bytes of padding, then the number of positions
        with_leftovers = data[:at] + random.bytes(3) + data[at + 3 :] + random.bytes(4)
        rows.append((topic, stamp, with_leftovers if topic == "/joint_states" else data))
    assert taken_at_once(tmp_path, rows, load_parameters({}), 100) == 4


ONE_ROW = {
    "nan angle": lambda _topic, stamp, _data: angle(stamp, float("nan")),
    "nan force": lambda _topic, stamp, _data: force(stamp, float("nan")),
    "inf": lambda _topic, stamp, _data: force(stamp, float("inf")),
    "missing": lambda _topic, stamp, _data: angle(stamp, 0.3, ("hip", "ankle")),
    "other order": lambda _topic, stamp, _data: angle(stamp, 0.3, ("knee", "hip")),
    "huge": lambda _topic, stamp, _data: angle(stamp, 11.0),
    "minus zero": lambda _topic, stamp, _data: angle(stamp, -0.0),
    "frame": lambda _topic, stamp, _data: force(stamp, 700.0, "other_tibia"),
    "late": lambda _topic, stamp, _data: force(max(stamp - 3 * MILLISECOND, 0), 650.0),
    "ahead": lambda _topic, stamp, _data: angle(stamp + 200 * MILLISECOND, 0.9),
    "force ahead": lambda _topic, stamp, _data: force(stamp + 30 * MILLISECOND, 9.0),
    "behind": lambda _topic, stamp, _data: force(max(stamp - 200 * MILLISECOND, 0), 9.0),
    "empty": lambda topic, stamp, _data: (topic, stamp, b""),
    "cut": lambda topic, stamp, data: (topic, stamp, data[:-3]),
    "byte order": lambda topic, stamp, data: (topic, stamp, b"\0\0" + data[2:]),
    "no representation": lambda topic, stamp, data: (topic, stamp, b"\7\7" + data[2:]),
}
"""What may become of a message"""
MANY_ROWS = {
    "twice": lambda rows, at: [*rows[: at + 1], *rows[at:]],
    "time jumps back": lambda rows, at: rows[:at] + gait(len(rows) // 3),
    "gap": lambda rows, at: rows[:at] + gait(20, begin=5000),
    "lost": lambda rows, at: rows[:at] + rows[at + 3 :],
    "a stream ends": lambda rows, at: (
        rows[: at + 9] + [row for row in rows[at + 9 :] if row[0] != rows[at][0]]
    ),
}
"""What may become of all from there on"""


def broken(kind, rows, at):
    """Rows with a fault."""
    if kind in MANY_ROWS:
        return MANY_ROWS[kind](rows, at)
    return [*rows[:at], ONE_ROW[kind](*rows[at]), *rows[at + 1 :]]


@settings(
    max_examples=15, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
@given(
    st.lists(
        st.tuples(st.sampled_from([*ONE_ROW, *MANY_ROWS]), st.floats(0.0, 0.999)), max_size=4
    ),
    st.sampled_from([1, 3, 10]),
    st.sampled_from([5, 16, 50]),
    st.sampled_from(list(PARAMETERS)),
)
def test_unusual_messages_give_the_same_file(tmp_path, faults, every, block, name):
    rows = gait(80, every)
    for kind, where in faults:
        rows = broken(kind, rows, int(where * len(rows)))
    taken_at_once(tmp_path, rows, load_parameters(PARAMETERS[name]), block)
