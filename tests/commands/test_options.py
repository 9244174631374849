"""Options on the command line as a user types them; `load` and `estimate-load`."""

from __future__ import annotations

import math
import re
import subprocess
import sys
from pathlib import Path

import pytest

from knee_contact_ros import estimate_load as estimate_load_in_python
from knee_contact_ros.bags.answers import read_bag
from knee_contact_ros.bags.provenance import change_record, provenance_record
from knee_contact_ros.bags.recorder import BagWriter
from knee_contact_ros.commands.live import replay
from knee_contact_ros.commands.main import main
from knee_contact_ros.joint_reaction.estimator import LOAD_LEVELS
from knee_contact_ros.joint_reaction.leg import GRAVITY
from knee_contact_ros.offline.estimate_load import estimate_load
from knee_contact_ros.parameters.files import load_parameters
from knee_contact_ros.parameters.load_schema import LoadParameters
from knee_contact_ros.streams.output import LOAD_PROVENANCE
from knee_contact_ros.streams.topics import LOAD_INPUTS, MESSAGE_TYPES, RECORDED
from tests.helpers.bags import raw_messages, write_rosbag2
from tests.helpers.needs import HAS_REPORT, needs_viewer
from tests.helpers.walking import WHOLE_LEG, walk, walking_bag

TOPICS = {f"/{topic}": MESSAGE_TYPES[topic] for topic in RECORDED}


def recorded(path: Path) -> list[tuple[str, int, str]]:
    return [(m.topic, m.log_time, str(m.message)) for m in read_bag(path, TOPICS)]


def test_solve_takes_inputs_and_parameters_from_elsewhere(
    right_bag: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The recording has the node's names, and what it would have without all this."""
    gait = raw_messages(right_bag)[:100]
    plain = write_rosbag2(tmp_path / "plain", gait)
    left = write_rosbag2(tmp_path / "left", gait, name=lambda topic: f"/left{topic}")
    damping = ["-p", "contact.damping:=900"]
    assert main(["solve", str(plain), *damping, "--output", str(tmp_path / "a.mcap")]) == 0
    assert (
        main(
            [
                "solve",
                str(left),
                "--namespace",
                "left",
                *damping,
                "--output",
                str(tmp_path / "b.mcap"),
            ]
        )
        == 0
    )
    remaps = [
        f"--remap={topic}:=/left/{topic}" for topic in ("joint_states", "joint_reaction_force")
    ]
    assert main(["solve", str(left), *remaps, "--output", str(tmp_path / "c.mcap")]) == 0
    assert recorded(tmp_path / "a.mcap") == recorded(tmp_path / "b.mcap")
    assert recorded(tmp_path / "a.mcap") != recorded(tmp_path / "c.mcap")  # the damping
    each = [
        write_rosbag2(tmp_path / topic[1:], [m for m in gait if m.topic == topic])
        for topic in {m.topic for m in gait}
    ]
    each += [
        write_rosbag2(tmp_path / "late", gait[50:]),
        write_rosbag2(tmp_path / "early", gait[:50]),
    ]
    for number in (0, 2):  # a recorder a topic, and bags that follow each other, in either order
        bags = [*map(str, each[number : number + 2])]
        assert main(["solve", *bags, *damping, "--output", str(tmp_path / f"{number}.mcap")]) == 0
        assert recorded(tmp_path / f"{number}.mcap") == recorded(tmp_path / "a.mcap")
    assert capsys.readouterr().err == ""  # no progress bar in a pipe
    assert main(["solve", str(plain), str(plain), "--output", str(tmp_path / "d.mcap")]) == 2
    assert capsys.readouterr().err == f"knee-contact: {plain} is given twice\n"
    cut = tmp_path / "cut.mcap"
    cut.write_bytes(next(plain.glob("*.mcap")).read_bytes()[:-100])
    assert main(["solve", str(plain), str(cut), "--output", str(tmp_path / "e.mcap")]) == 1
    assert f"knee-contact: bag {plain} and {cut} is damaged, " in (told := capsys.readouterr().err)
    assert f"{cut}: the end is missing" in told  # by the names that were given


@pytest.mark.parametrize(
    ("arguments", "clock", "bag"),
    [
        (["bag"], None, "bag"),
        (["bag", "--clock"], 0.0, "bag"),
        (["--clock", "bag"], 0.0, "bag"),
        (["--clock", "--loop", "bag"], 0.0, "bag"),
        (["--clock", "40", "bag"], 40.0, "bag"),
        (["bag", "--clock=2.5"], 2.5, "bag"),
    ],
)
def test_the_clocks_rate_may_be_left_out(
    arguments: list[str], clock: float | None, bag: str
) -> None:
    taken = replay.make_context("replay", arguments).params
    assert (taken["clock"], taken["bag"]) == (clock, Path(bag))


Said = pytest.CaptureFixture[str]


@pytest.fixture(scope="module")
def walking(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A bag of a walking leg."""
    return walking_bag(tmp_path_factory.mktemp("walk") / "walk.mcap", walk())


@pytest.fixture(scope="module")
def estimated(walking: Path) -> Path:
    """What is made of it with all that it tells."""
    output = walking.with_name("load.mcap")
    estimate_load(walking, load_parameters(WHOLE_LEG, LoadParameters), output)
    return output


@pytest.mark.parametrize("asks", [["load", "-h"], ["estimate-load", "--help"]])
def test_help_needs_no_ros_and_says_which_topics(asks: list[str]) -> None:
    code = (
        "import sys; sys.modules['rclpy'] = None; from knee_contact_ros.commands.main import main; "
        f"sys.exit(main({asks}))"
    )
    done = subprocess.run(
        [sys.executable, "-c", code, *asks],
        capture_output=True,
        text=True,
        timeout=60,
        check=False,
    )
    assert (done.returncode, done.stderr) == (0, "")
    assert done.stdout.startswith(f"Usage: knee-contact {asks[0]} ")
    assert re.search(r"joint_states\s+and\s+/?ground_reaction_force", done.stdout)


def test_the_table_says_the_level_the_parts_and_how_sure_it_is(
    walking: Path, tmp_path: Path, capsys: Said
) -> None:
    output = tmp_path / "out.mcap"
    arguments = [
        "estimate-load",
        str(walking),
        "--params",
        "load/inverse_dynamics",
        "-p",
        "person.mass:=80",
    ]
    assert main([*arguments, "--output", str(output)]) == 0
    said = capsys.readouterr()
    rows = dict(re.findall(r"^ ?((?:  )?[a-z][a-z ]*?)  +(\S.*?) *$", said.out, re.MULTILINE))
    forces = {
        name: float(value.split()[0])
        for name, value in rows.items()
        if re.match(r"-?\d+\.\d +-?\d+\.\d\d$", value)
    }
    parts = [
        forces[f"  {name}"]
        for name in ("without muscles", "quadriceps", "hamstrings", "gastrocnemius")
    ]
    assert sum(parts) == pytest.approx(
        forces["largest joint reaction"], abs=0.25
    )  # five numbers of one decimal
    floor, part = LOAD_LEVELS["ankle_moment"].uncalibrated
    deviation = math.hypot(floor * 80.0 * GRAVITY, part * forces["largest joint reaction"])
    assert forces["standard deviation"] == pytest.approx(deviation, abs=0.1)  # one decimal
    assert rows["level"] == "ankle_moment"
    assert rows["constants"].startswith("not calibrated to this person")
    assert rows["parameters"] == "load/inverse_dynamics, person.mass:=80"
    assert rows["estimates"] == "240 over 1.20 s"
    assert (rows["samples refused"], rows["estimates flagged"]) == ("0", "0")
    assert f"Bag: {output}" in said.out


def test_a_recording_is_computed_again_with_its_own_parameters(
    estimated: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: Said
) -> None:
    own = estimate_load_in_python(estimated)
    assert (own == estimate_load_in_python(estimated, WHOLE_LEG)).all()
    other = estimate_load_in_python(estimated, values={"person.tone": 0.5})
    assert (other == estimate_load_in_python(estimated, [WHOLE_LEG, {"person.tone": 0.5}])).all()
    assert (own["axial_force"] < other["axial_force"]).all()
    assert main(["estimate-load", str(estimated), "--output", str(tmp_path / "again.mcap")]) == 0
    assert re.search(r"parameters +those in load\.mcap", capsys.readouterr().out)
    assert (estimate_load_in_python(tmp_path / "again.mcap") == own).all()


def test_changes_of_parameters_in_a_recording_are_told(tmp_path: Path, capsys: Said) -> None:
    bag = tmp_path / "changed.mcap"
    with BagWriter(bag) as writer:
        for topic in LOAD_INPUTS:
            writer.add_topic(f"/{topic}", MESSAGE_TYPES[topic])
        writer.add_metadata(
            LOAD_PROVENANCE, provenance_record(load_parameters(WHOLE_LEG, LoadParameters))
        )
        writer.add_metadata("parameters_changed", change_record(10, {"person.tone": 0.5}))
        writer.add_metadata("parameters_changed", change_record(20, {"diagnostics.timeout": 2.0}))
        for message in walk():
            writer.write_message(message.topic, message.log_time, message.data)
    assert main(["estimate-load", str(bag), "--output", str(tmp_path / "again.mcap")]) == 0
    assert "parameters changed 1 times in it; those of its beginning are used" in " ".join(
        capsys.readouterr().err.split()
    )


@pytest.mark.skipif(not HAS_REPORT, reason="needs the extra report")
def test_a_report_computes_the_contact_of_estimated_loads(estimated: Path, tmp_path: Path) -> None:
    assert main(["report", str(estimated), "--output", str(tmp_path / "report")]) == 0
    assert (tmp_path / "report" / "report.html").exists()


@needs_viewer
def test_a_view_computes_the_contact_of_estimated_loads(estimated: Path, tmp_path: Path) -> None:
    assert main(["view", str(estimated), "--save", str(tmp_path / "knee.rrd")]) == 0
    assert (tmp_path / "knee.rrd").exists()
