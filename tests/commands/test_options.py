"""Options on the command line as a user types them; `load` and `estimate-load`."""

from __future__ import annotations

import math
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

from knee_contact_ros import estimate_load as estimate_load_in_python
from knee_contact_ros.bags.provenance import change_record, provenance_record
from knee_contact_ros.bags.reader import read_bag
from knee_contact_ros.bags.recorder import BagWriter
from knee_contact_ros.commands.live import replay
from knee_contact_ros.commands.main import main
from knee_contact_ros.joint_reaction.estimator import LEVELS
from knee_contact_ros.joint_reaction.leg import GRAVITY
from knee_contact_ros.offline.estimate_load import estimate_load
from knee_contact_ros.parameters.files import load_parameters
from knee_contact_ros.parameters.schema import LoadParameters
from knee_contact_ros.streams.output import LOAD_PROVENANCE
from knee_contact_ros.streams.topics import LOAD_INPUTS, MESSAGE_TYPES, RECORDED
from tests.helpers.bags import write_rosbag2
from tests.helpers.messages import raw_inputs
from tests.helpers.needs import HAS_REPORT, needs_viewer
from tests.helpers.walking import WHOLE_LEG, walk, walking_bag

TOPICS = {f"/{topic}": MESSAGE_TYPES[topic] for topic in RECORDED}


def recorded(path: Path) -> list[tuple[str, int, str]]:
    return [(m.topic, m.log_time, str(m.message)) for m in read_bag(path, TOPICS)]


def test_solve_takes_inputs_and_parameters_from_elsewhere(
    right_bag: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The recording has the node's names, and what it would have without all this."""
    gait = raw_inputs(right_bag)[:100]
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


COMMANDS = {
    "solve": ["solve", "{}", "--output", "o.mcap"],
    "solve --params": ["solve", "--params", "{}", "--output", "o.mcap"],
    "solve --subject": ["solve", "--subject", "{}", "--output", "o.mcap"],
    "view": ["view", "{}", "--save", "o.rrd"],
    "estimate-load": ["estimate-load", "{}", "--output", "o.mcap"],
    "recover": ["recover", "{}", "o.mcap"],
    "replay": ["replay", "{}"],
    "demo": ["demo", "--bag", "{}"],
    "report": ["report", "{}", "--output", "o"],
    "report --compare": ["report", "--compare", "{}", "--output", "o"],
    "sweep": ["sweep", "{}", "--output", "o"],
    "trade": ["trade", "{}", "--output", "o"],
    "fit-profile": ["fit-profile", "{}", "--output", "o.csv"],
    "calibrate": ["calibrate", "{}", "--output", "o.yaml"],
}


@pytest.mark.parametrize("name", COMMANDS)
@pytest.mark.parametrize("kind", ["loop", "pipe", "device", "folder"])
def test_what_is_no_file_is_refused_in_one_line_and_not_waited_for(
    name: str,
    kind: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("loop").symlink_to("loop")
    Path("folder").mkdir()
    os.mkfifo("pipe")
    path = "/dev/zero" if kind == "device" else kind
    assert main([word.format(path) for word in COMMANDS[name]]) == 2
    assert len(capsys.readouterr().err.splitlines()) == 1


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


@pytest.mark.parametrize(
    "arguments",
    [
        "align a.csv --map own.yaml --output own.yaml --overwrite",
        "calibrate a.csv --params own.yaml --free load.share --output own.yaml --overwrite",
        "table own.csv --output own.csv",
        "trade own.png --picture own.png",
    ],
)
def test_an_input_is_never_replaced(
    arguments: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: Said
) -> None:
    monkeypatch.chdir(tmp_path)
    own = Path(arguments.split()[-1 - arguments.endswith("--overwrite")])
    own.write_text("precious")
    assert main(arguments.split()) == 2
    assert f"{own} is the input, which is never changed" in capsys.readouterr().err
    assert own.read_text() == "precious"


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
    floor, part = LEVELS["ankle_moment"].uncalibrated
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
            writer.write(message.topic, message.log_time, message.data)
    assert main(["estimate-load", str(bag), "--output", str(tmp_path / "again.mcap")]) == 0
    assert "parameters changed 1 times in it; those of its beginning are used" in " ".join(
        capsys.readouterr().err.split()
    )


MISTAKEN = [
    (
        "solve -p knee.joint_name:=hip",
        r"has no joint 'hip'; it has knee \(parameter knee\.joint_name\)",
    ),
    ("solve -p load.share=1", "-p 'load.share=1': it must be NAME:=VALUE"),
    ("solve --namespace left", "has no topic /left/joint_states"),
    ("solve --remap angles:=/exo", "FROM must be joint_states or joint_reaction_force"),
    (
        "estimate-load --params healthy",
        r"healthy\.yaml: no parameters for node knee_load; found /\*\*/knee_contact",
    ),
    ("estimate-load --params inverse_dynamic", r"did you mean load/inverse_dynamics\?"),
    (
        "estimate-load -p knee.joint_nam:=x",
        r"unknown parameter knee\.joint_nam; did you mean knee\.joint_name\?",
    ),
    ("estimate-load -p level:=5", "parameter level: 5 is not allowed"),
    (
        "estimate-load --remap joint_reaction_force:=/x",
        "FROM must be joint_states or ground_reaction_force",
    ),
]


@pytest.mark.parametrize(("words", "told"), MISTAKEN)
def test_bad_parameters_and_rules_are_told_in_one_line(
    words: str, told: str, right_bag: Path, walking: Path, tmp_path: Path, capsys: Said
) -> None:
    command, *more = words.split()
    bag = right_bag if command == "solve" else walking
    assert main([command, str(bag), *more, "--output", str(tmp_path / "out.mcap")]) == 2
    said = capsys.readouterr()
    assert re.search(told, said.err), said.err
    assert (said.out, len(said.err.splitlines())) == ("", 1)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("asks", ["solve", "replay", "estimate-load", "replay --sensors"])
def test_what_is_not_an_input_is_not_taken_for_one(
    walking: Path, right_bag: Path, tmp_path: Path, capsys: Said, asks: str
) -> None:
    sensed = asks in ("solve", "replay")
    missing, there = ("joint_reaction_force", "ground_reaction_force")[:: 1 if sensed else -1]
    words = rf"no topic /{missing} .*; its topics: /{there}, .*; --remap {missing}:=TOPIC or --namespace NAME reads ano"
    output = [] if "replay" in asks else ["--output", str(tmp_path / "out.mcap")]
    assert main([*asks.split(), str(walking if sensed else right_bag), *output]) == 2
    said = capsys.readouterr().err
    assert re.search(words, said)
    assert len(said.splitlines()) == 1
    assert not list(tmp_path.iterdir())


@pytest.mark.skipif(not HAS_REPORT, reason="needs the extra report")
def test_a_report_computes_the_contact_of_estimated_loads(estimated: Path, tmp_path: Path) -> None:
    assert main(["report", str(estimated), "--output", str(tmp_path / "report")]) == 0
    assert (tmp_path / "report" / "report.html").exists()


@needs_viewer
def test_a_view_computes_the_contact_of_estimated_loads(estimated: Path, tmp_path: Path) -> None:
    assert main(["view", str(estimated), "--save", str(tmp_path / "knee.rrd")]) == 0
    assert (tmp_path / "knee.rrd").exists()
