"""Recordings that other tools have rewritten, merged or cut: their answers are compared, and never mixed."""

import random

import pytest
from mcap.reader import make_reader
from mcap.writer import Writer

from knee_contact_ros.bags.answers import read_answers
from knee_contact_ros.bags.bag import Bag
from knee_contact_ros.bags.provenance import read_provenance
from knee_contact_ros.system.errors import UsageError
from tests.helpers.commands import run
from tests.helpers.needs import HAS_VIEWER
from tests.helpers.offline import solve


def rewritten(target, *sources, metadata):
    """What `mcap merge`, `mcap filter` and `ros2 bag convert` make of recordings, with or without their metadata."""
    rows = []
    with target.open("wb") as output:
        writer, channels = Writer(output), {}
        writer.start(profile="ros2", library="somebody's")
        for number, source in enumerate(sources):
            with source.open("rb") as stream:
                reader = make_reader(stream)
                rows += [(each[2].log_time, number, *each) for each in reader.iter_messages()]
                for record in reader.iter_metadata() if metadata else ():
                    writer.add_metadata(record.name, record.metadata)
        for time, _, schema, channel, message in sorted(rows, key=lambda row: row[:2]):
            if channel.topic not in channels:
                known = writer.register_schema(schema.name, schema.encoding, schema.data)
                channels[channel.topic] = writer.register_channel(channel.topic, "cdr", known)
            writer.add_message(channels[channel.topic], time, message.data, time)
        writer.finish()
    return target


def drawn_parameters(draw):
    """Parameters whose depths are far from those of the healthy knee, or its own."""
    changes = (
        {},
        {"contact.stiffness": 7.905694e7 * draw.choice((0.4, 2.5))},
        {"load.share": draw.choice((0.3, 0.8))},
        {"contact.exponent": 1.2},
        {"knee.flexion_offset": 0.01, "load.share": 1.0},
    )
    return draw.choice(changes)


@pytest.fixture(scope="module")
def recordings(right_bag, tmp_path_factory):
    """Makes a recording with parameters."""
    folder, made = tmp_path_factory.mktemp("recordings"), {}

    def recording(values):
        path = folder / f"{len(made)}.mcap"
        if str(values) not in made:
            solve(right_bag, values, path)
            made[str(values)] = path
        return made[str(values)]

    return recording


@pytest.mark.parametrize("seed", range(12))
def test_lost_parameters_are_told_by_the_answers(recordings, tmp_path, seed):
    values = drawn_parameters(random.Random(seed))
    source = recordings(values)
    lost = rewritten(tmp_path / "lost.mcap", source, metadata=False)
    summary = solve(lost, {}, None)
    assert bool(summary.differing) == bool(values)
    if values:
        depth = read_answers(source)["penetration_depth"].max()
        assert f"{1e3 * depth:.4f} mm there" in summary.differing
    assert not solve(lost, values, None).differing
    kept = rewritten(tmp_path / "kept.mcap", source, metadata=True)
    basis = read_provenance(kept)
    assert basis is not None
    assert not solve(kept, basis, None).differing


def test_merged_recordings_are_not_mixed(recordings, tmp_path):
    one, other = recordings({}), recordings({"load.share": 0.8})
    for metadata in (True, False):
        merged = rewritten(tmp_path / f"{metadata}.mcap", one, other, metadata=metadata)
        with pytest.raises(UsageError, match="several runs, mixed by another tool"):
            read_answers(merged)
    lost = tmp_path / "False.mcap"
    assert "several runs" in solve(lost, {}, None).differing
    with Bag(tmp_path / "True.mcap") as bag, pytest.raises(UsageError, match="2 sets of param"):
        read_provenance(bag)
    for command in ("report", "view", "table", "solve"):
        out = {"report": "r", "view": "v.rrd", "table": "t.csv", "solve": "o.mcap"}[command]
        option = "--save" if command == "view" else "--output"
        assert run(f"{command} {tmp_path}/True.mcap {option} {tmp_path}/{out}") == 2, command


def test_each_command_says_that_parameters_are_lost(recordings, tmp_path, capsys):
    soft = recordings({"contact.stiffness": 3e7})
    lost = rewritten(tmp_path / "lost.mcap", soft, metadata=False)
    outputs = {"report": "r", "solve": "o.mcap", "trade": "t.png"}
    for command, output in (outputs | ({"view": "v.rrd"} if HAS_VIEWER else {})).items():
        option = {"view": "--save", "trade": "--picture"}.get(command, "--output")
        code = run(f"{command} {lost} {option} {tmp_path}/{output}")
        assert (command, code) == (command, int(command == "solve"))
        assert "holds answers of other parameters or inputs" in capsys.readouterr().err, command
