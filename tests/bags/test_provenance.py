"""A recording says how it came about, and can be computed again from itself alone."""

import hashlib
import json
import shutil

import numpy as np
import pytest
from mcap.reader import make_reader

from knee_contact_ros.bags.answers import read_answers
from knee_contact_ros.bags.bag import Bag
from knee_contact_ros.bags.folder import bag_digest, files_digest, others_beside
from knee_contact_ros.bags.provenance import (
    Change,
    change_record,
    provenance_record,
    read_provenance,
)
from knee_contact_ros.bags.recorder import BagWriter, FileLimits
from knee_contact_ros.parameters.files import load_parameters
from knee_contact_ros.streams.messages import JointState, encode_joint_state
from knee_contact_ros.streams.output import PROVENANCE
from knee_contact_ros.system.errors import UsageError
from tests.helpers.commands import run
from tests.helpers.offline import solve
from tests.helpers.recordings_of import recording_with


def messages(path):
    """All of a recording, in the order of the file."""
    with path.open("rb") as file:
        return [
            (channel.topic, message.log_time, message.sequence, message.data)
            for _, channel, message in make_reader(file).iter_messages(log_time_order=False)
        ]


def metadata(path):
    """Metadata records in the order of the file."""
    with path.open("rb") as file:
        return [(record.name, record.metadata) for record in make_reader(file).iter_metadata()]


def test_a_recording_is_computed_again_from_itself_alone(config, right_bag, tmp_path, capsys):
    """Even where the files that its parameters named are gone."""
    profile, mine = tmp_path / "my_femur.csv", tmp_path / "mine.yaml"
    shutil.copy(config / "femur_medial.csv", profile)
    mine.write_text(
        f"knee_contact: {{ros__parameters: {{femur: {{geometry: profile, profile: {profile}}}}}}}"
    )
    first, second, third = (tmp_path / f"{name}.mcap" for name in ("first", "second", "third"))
    solve(right_bag, load_parameters(["osteoarthritis", mine]), first)
    profile.unlink()
    assert run(f"solve {first} --output {second}") == 0
    assert f"those in {first.name}, made with knee_contact_ros" in capsys.readouterr().out
    assert messages(second) == messages(first)
    found = read_provenance(second)
    assert found is not None
    assert found.parameters == load_parameters(["osteoarthritis", mine])
    solve(second, found, third)
    assert messages(third) == messages(first)
    assert run(f"solve {first} --params healthy.yaml --output {tmp_path}/fourth.mcap") == 0
    assert messages(tmp_path / "fourth.mcap") != messages(first)


def test_a_recording_from_before_a_field_and_a_parameter_is_computed_again(
    old_recording, right_bag, tmp_path
):
    found = read_provenance(old_recording)
    assert found is not None
    assert found.parameters.fidelity.force_tolerance == 0.0  # the default: it knew of none
    solve(old_recording, found, tmp_path / "again.mcap")
    solve(right_bag, load_parameters(["healthy"]), tmp_path / "new.mcap")
    assert messages(tmp_path / "again.mcap") == messages(tmp_path / "new.mcap")


def test_the_record_names_package_model_parameters_and_source(right_bag, tmp_path):
    copied = tmp_path / "bag.mcap"
    shutil.copy(next(right_bag.glob("*.mcap")), copied)
    solve(copied, load_parameters("healthy"), tmp_path / "out.mcap")
    record = dict(metadata(tmp_path / "out.mcap"))[PROVENANCE]
    assert record["source"] == "bag.mcap"
    assert record["source_sha256"] == hashlib.sha256(copied.read_bytes()).hexdigest()
    assert len(record["model_sha256"]) == 64
    parameters = json.loads(record["parameters"])
    assert parameters["contact.stiffness"] == load_parameters("healthy").contact.stiffness
    assert not [name for name in parameters if name.startswith(("record", "rerun", "autostart"))]


def test_changes_of_the_node_are_repeated(right_bag, tmp_path):
    """Changes count from the beginning of the recording, whatever the node had computed before."""
    recording = tmp_path / "out.mcap"
    with BagWriter(recording) as bag:
        bag.add_metadata(
            "knee_contact",
            provenance_record(load_parameters({"load.share": 0.6}), {}, ticks_before=1000),
        )
        bag.add_metadata(
            "parameters_changed", change_record(1100, {"contact.damping": 0.0, "deadline": 0.5})
        )
        bag.add_metadata("reset", {"tick": "1200", "waiting": "1"})
    found = read_provenance(recording)
    assert found is not None
    assert found.parameters.load.share == 0.6
    assert found.changes == (
        Change(100, {"contact.damping": 0.0, "deadline": 0.5}),
        Change(200, None, 1),
    )
    redone = tmp_path / "redone.mcap"
    solve(right_bag, found, redone)
    plain = tmp_path / "plain.mcap"
    solve(right_bag, found.parameters, plain)
    answers, unchanged = (read_answers(path)["penetration_depth"] for path in (redone, plain))
    assert np.array_equal(answers[:100], unchanged[:100])
    assert answers[100] != unchanged[100]
    again = read_provenance(redone)
    assert again is not None
    assert again.changes == found.changes
    assert dict(metadata(redone))["reset"] == {"tick": "200", "waiting": "1"}


BROKEN = {
    "no value": (
        "parameters_changed",
        {"tick": "100", "contact.damping": "{"},
        "parameters_changed (tick 100)",
    ),
    "a value as deep as can be": (
        "parameters_changed",
        {"tick": "100", "contact.damping": "[" * 100_000},
        "(tick 100)",
    ),
    "no tick": ("reset", {}, "a record reset is damaged"),
}


@pytest.mark.parametrize("name", BROKEN)
def test_a_damaged_change_is_reported(name, right_bag, tmp_path, capsys):
    """The others are made, all ticks computed, and the command ends as with a damaged bag."""
    kind, values, words = BROKEN[name]
    ours = provenance_record(load_parameters({}), {})
    good = ("parameters_changed", change_record(200, {"contact.damping": 0.0}))
    recording = recording_with(
        tmp_path / "in.mcap", right_bag, [("knee_contact", ours), (kind, values), good]
    )
    assert run(f"solve {recording} --output {tmp_path}/out.mcap") == 1
    (line,) = capsys.readouterr().err.splitlines()
    assert words in line
    assert line.endswith("is damaged; its change is not repeated")
    found = dict(metadata(tmp_path / "out.mcap"))
    assert found["parameters_changed"] == {"tick": "200", "contact.damping": "0.0"}
    assert words in found["source_damage"]["faults"]


def test_a_change_that_cannot_be_made_is_refused(right_bag, tmp_path, capsys):
    ours = provenance_record(load_parameters({}), {})
    changed = ("parameters_changed", {"tick": "100", "contact.dampinh": "1.0"})
    recording = recording_with(tmp_path / "in.mcap", right_bag, [("knee_contact", ours), changed])
    assert run(f"solve {recording} --output {tmp_path}/out.mcap") == 2
    assert (
        "a change after 100 ticks that cannot be made: unknown parameter contact.dampinh"
        in capsys.readouterr().err
    )


def test_a_cut_off_recording_has_its_parameters(right_bag, tmp_path):
    solve(right_bag, load_parameters("osteoarthritis"), tmp_path / "out.mcap")
    cut = tmp_path / "cut.mcap"
    cut.write_bytes((tmp_path / "out.mcap").read_bytes()[:-5000])
    found = read_provenance(cut)
    assert found is not None
    assert found.parameters == load_parameters("osteoarthritis")


def test_a_later_file_alone_has_no_parameters(tmp_path):
    with BagWriter(tmp_path / "run_0.mcap", limits=FileLimits(duration=10.0)) as bag:
        bag.add_topic("/joint_states", "sensor_msgs/msg/JointState")
        bag.add_metadata("knee_contact", provenance_record(load_parameters({}), {}))
        for stamp in (0, 20):
            bag.split_if_due(stamp)
            bag.write_message(
                "/joint_states", stamp, encode_joint_state(JointState(stamp, "", (), (), (), ()))
            )
    with pytest.raises(UsageError, match=r"run_1.mcap continues run_0.mcap"):
        read_provenance(tmp_path / "run_1.mcap")
    for whole in (tmp_path, tmp_path / "run_0.mcap"):
        assert read_provenance(whole) is not None


def test_another_recording_in_the_folder_is_ignored(right_bag, tmp_path):
    shutil.copytree(right_bag, tmp_path / "bag")
    folder, digest = tmp_path / "bag", bag_digest(tmp_path / "bag")
    with BagWriter(folder / "a_earlier.mcap") as bag:
        bag.add_metadata(
            "knee_contact", provenance_record(load_parameters({"load.share": 0.9}), {})
        )
        bag.add_metadata("reset", {"tick": "5"})
    assert read_provenance(folder / "a_earlier.mcap") is not None
    assert read_provenance(folder) is None
    assert bag_digest(folder) == digest
    with Bag(folder) as opened:
        assert opened.digest == digest
    renamed = (folder / "metadata.yaml").rename(tmp_path / "other.yaml")
    assert files_digest([renamed]) != files_digest([right_bag / "metadata.yaml"])
    assert others_beside(right_bag) == others_beside(folder / "a_earlier.mcap") == []
