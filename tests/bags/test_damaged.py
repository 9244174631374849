"""Damaged bags in `solve`: what can be read is computed, and what is missing is said."""

from mcap.reader import make_reader
from mcap.writer import CompressionType

from knee_contact_ros.bags.answers import read_bag
from knee_contact_ros.bags.bag import Bag
from knee_contact_ros.model.types import Status
from knee_contact_ros.offline.output import SOURCE_DAMAGE
from knee_contact_ros.parameters.files import load_parameters
from knee_contact_ros.streams.topics import KNEE_CONTACT, MESSAGE_TYPES, stamp_to_ns
from studies.fuzz_bags.bags import TICKS, mcap, messages, split, sqlite
from tests.bags.test_mcap_file import chunks
from tests.helpers.bags import raw_messages
from tests.helpers.commands import run
from tests.helpers.offline import solve

CONTACT = {f"/{KNEE_CONTACT}": MESSAGE_TYPES[KNEE_CONTACT]}


def damage_of(bag):
    with Bag(bag) as opened:
        return opened.damage


def test_the_answer_after_a_hole_is_stale(tmp_path):
    bag = tmp_path / "bag.mcap"
    mcap(bag, CompressionType.NONE)
    content = bytearray(bag.read_bytes())
    for offset, length in chunks(bag)[
        2:4
    ]:  # 30 ticks, 0.15 s: longer than may be between two stamps
        content[offset + length // 2] ^= 1
    bag.write_bytes(content)
    summary = solve(bag, load_parameters({}), tmp_path / "out.mcap")
    assert summary.damage
    answers = [m.message for m in read_bag(tmp_path / "out.mcap", CONTACT)]
    stamps = [stamp_to_ns(answer.header.stamp) for answer in answers]
    behind = [
        index for index in range(1, len(stamps)) if stamps[index] - stamps[index - 1] > 100_000_000
    ]
    assert len(behind) == 1
    assert [
        index for index, answer in enumerate(answers) if answer.status & Status.STALE_INPUT
    ] == behind
    with (tmp_path / "out.mcap").open("rb") as file:
        notes = {record.name: record.metadata for record in make_reader(file).iter_metadata()}
    assert notes[SOURCE_DAMAGE] == {"source": "bag.mcap", "faults": "\n".join(summary.damage)}


def test_the_command_ends_with_code_1_and_one_line(tmp_path, capsys):
    bag = tmp_path / "bag.mcap.partial"
    mcap(bag, CompressionType.ZSTD)
    bag.write_bytes(bag.read_bytes()[:6000])
    assert run(f"solve {bag} --output {tmp_path}/out.mcap") == 1
    said = capsys.readouterr().err
    assert said.count("\n") == 1
    assert "bag.mcap.partial is damaged, and solved as far as it can be read" in said
    assert "the end is missing" in said
    assert 0 < len(read_bag(tmp_path / "out.mcap", CONTACT)) < TICKS


def test_without_metadata_the_numbered_files_are_the_bag(tmp_path):
    split(tmp_path / "bag")
    (tmp_path / "bag" / "metadata.yaml").unlink()
    assert [tuple(message) for message in raw_messages(tmp_path / "bag")] == list(messages())
    assert damage_of(tmp_path / "bag") == ["metadata.yaml is missing"]
    (tmp_path / "bag" / "metadata.yaml").write_text("{")
    assert damage_of(tmp_path / "bag") == ["metadata.yaml cannot be read"]


def test_of_several_sqlite3_files_one_may_be_broken(tmp_path):
    sqlite(tmp_path / "bag")
    (tmp_path / "bag" / "bag_1.db3").write_bytes(b"")
    metadata = tmp_path / "bag" / "metadata.yaml"
    metadata.write_text(metadata.read_text().replace("- bag.db3", "- bag.db3\n  - bag_1.db3", 1))
    assert [tuple(message) for message in raw_messages(tmp_path / "bag")] == list(messages())
    assert any(fault.startswith("bag_1.db3: ") for fault in damage_of(tmp_path / "bag"))


def test_a_file_that_metadata_does_not_list_is_missed_by_its_messages(tmp_path):
    split(tmp_path / "bag")
    metadata = tmp_path / "bag" / "metadata.yaml"
    metadata.write_text(
        "\n".join(
            line for line in metadata.read_text().splitlines() if line.strip() != "- bag_1.mcap"
        )
    )
    assert any(
        "messages of metadata.yaml are missing" in fault for fault in damage_of(tmp_path / "bag")
    )
