"""Options on the command line as a user types them."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from knee_contact_ros.bags.reader import read_bag
from knee_contact_ros.commands.live import replay
from knee_contact_ros.commands.main import main
from knee_contact_ros.streams.topics import MESSAGE_TYPES, RECORDED
from tests.helpers.bags import write_rosbag2
from tests.helpers.messages import raw_inputs

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
    assert main(["solve", str(left), "--namespace", "left", *damping, "--output", str(tmp_path / "b.mcap")]) == 0
    remaps = [f"--remap={topic}:=/left/{topic}" for topic in ("joint_states", "joint_reaction_force")]
    assert main(["solve", str(left), *remaps, "--output", str(tmp_path / "c.mcap")]) == 0
    assert recorded(tmp_path / "a.mcap") == recorded(tmp_path / "b.mcap")
    assert recorded(tmp_path / "a.mcap") != recorded(tmp_path / "c.mcap")  # the damping
    each = [
        write_rosbag2(tmp_path / topic[1:], [m for m in gait if m.topic == topic]) for topic in {m.topic for m in gait}
    ]
    each += [write_rosbag2(tmp_path / "late", gait[50:]), write_rosbag2(tmp_path / "early", gait[:50])]
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
    ("arguments", "words"),
    [
        (["-p", "knee.joint_name:=hip"], "joint_states has no joint 'hip'; it has knee (parameter knee.joint_name)"),
        (["-p", "load.share=1"], "-p 'load.share=1': it must be NAME:=VALUE"),
        (["--namespace", "left"], "has no topic /left/joint_states"),
        (["--remap", "angles:=/exo"], "FROM must be joint_states or joint_reaction_force"),
    ],
)
def test_what_solve_cannot_take_is_told_in_one_line(
    arguments: list[str], words: str, right_bag: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["solve", str(right_bag), *arguments, "--output", str(tmp_path / "out.mcap")]) == 2
    errors = capsys.readouterr().err
    assert words in errors
    assert len(errors.splitlines()) == 1
    assert list(tmp_path.iterdir()) == []


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
def test_the_clocks_rate_may_be_left_out(arguments: list[str], clock: float | None, bag: str) -> None:
    taken = replay.make_context("replay", arguments).params
    assert (taken["clock"], taken["bag"]) == (clock, Path(bag))


COMMANDS = {
    "solve": ["solve", "{}", "--output", "o.mcap"], "solve --params": ["solve", "--params", "{}", "--output", "o.mcap"],
    "solve --subject": ["solve", "--subject", "{}", "--output", "o.mcap"], "view": ["view", "{}", "--save", "o.rrd"],
    "estimate-load": ["estimate-load", "{}", "--output", "o.mcap"], "recover": ["recover", "{}", "o.mcap"],
    "replay": ["replay", "{}"], "demo": ["demo", "--bag", "{}"], "report": ["report", "{}", "--output", "o"],
    "report --compare": ["report", "--compare", "{}", "--output", "o"], "sweep": ["sweep", "{}", "--output", "o"],
    "trade": ["trade", "{}", "--output", "o"], "fit-profile": ["fit-profile", "{}", "--output", "o.csv"],
    "calibrate": ["calibrate", "{}", "--output", "o.yaml"],
}  # fmt: skip


@pytest.mark.parametrize("name", COMMANDS)
@pytest.mark.parametrize("kind", ["loop", "pipe", "device", "folder"])
def test_what_is_no_file_is_refused_in_one_line_and_not_waited_for(
    name: str, kind: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("loop").symlink_to("loop")
    Path("folder").mkdir()
    os.mkfifo("pipe")
    path = "/dev/zero" if kind == "device" else kind
    assert main([word.format(path) for word in COMMANDS[name]]) == 2
    assert len(capsys.readouterr().err.splitlines()) == 1
