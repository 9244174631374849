"""Messages in columns: cut, joined, found in chunks and written, they are the same as one by one."""

import struct
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from knee_contact_ros.bags.arrival import in_batches_of
from knee_contact_ros.bags.bag_file import Batch
from knee_contact_ros.bags.batch_writer import TopicMessages, write_messages
from knee_contact_ros.bags.mcap_file import DamagedError, chunk_content
from knee_contact_ros.bags.recorder import BagWriter
from knee_contact_ros.streams.columns import Column
from knee_contact_ros.streams.topics import MESSAGE_TYPES, RECORDED
from tests.hostile.bags import message

ROWS = [(number % 3, 7 * number % 40, b"%d" % number) for number in range(40)]
NAMES = [f"/{topic}" for topic in RECORDED]


def batch(rows):
    numbers, times, data = zip(*rows, strict=True)
    return Batch(np.array(numbers, np.intp), np.array(times, np.uint64), Column.of(data))


@pytest.mark.parametrize("most", [1, 3, 8, 39, 40, 41])
@pytest.mark.parametrize("sizes", [[40], [0, 5, 0, 35], [1] * 40, [17, 23]])
def test_blocks_are_of_one_size(most, sizes):
    ends = np.cumsum(sizes).tolist()
    batches = [
        batch(ROWS).select(slice(end - size, end)) for size, end in zip(sizes, ends, strict=True)
    ]
    found = list(in_batches_of(most, batches))
    assert [row for block in found for row in block] == ROWS
    assert all(len(block) == most for block in found[:-1])
    assert 0 < len(found[-1]) <= most


DATA = b"".join(message(number % 2 + 1, b"m" * (number % 5), 100 + number) for number in range(40))
PLACES = [at for at in range(len(DATA)) if DATA[at : at + 1] == b"\5"]


@pytest.mark.parametrize("length", [0, 21, 2**63, 2**64 - 9])
def test_a_length_that_leads_back_is_damage(length):
    data = bytearray(DATA)
    data[PLACES[4] + 1 : PLACES[4] + 9] = struct.pack("<Q", length)
    with pytest.raises(DamagedError, match="bytes that are not records"):
        chunk_content(bytes(data))
    assert len(chunk_content(bytes(data), is_cut=True)[0]) == 4


def rows_of(dice, most, longest):
    """Up to so many messages of each topic, in any order and of any stamps; of some topics none."""
    rows = []
    for name in dice.permutation(NAMES).tolist():
        number = int(dice.integers(most + 1)) if dice.random() < 0.8 else 0
        stamps = 1_000_000 + dice.integers(-1000, 1000, number)
        data = dice.integers(256, size=(number, int(dice.integers(longest))), dtype=np.uint8)
        rows.append(
            TopicMessages(name, stamps, data, np.sort(dice.integers(most + 1, size=number)))
        )
    return rows


def one_by_one(bag, rows):
    order = sorted(
        (int(place), number, i)
        for number, row in enumerate(rows)
        for i, place in enumerate(row.place)
    )
    for _, number, i in order:
        bag.write_message(
            rows[number].topic, int(rows[number].stamps[i]), rows[number].data[i].tobytes()
        )


@settings(max_examples=15, deadline=None)
@given(
    seed=st.integers(0, 2**32 - 1),
    most=st.sampled_from([1, 5, 300]),
    longest=st.sampled_from([1, 300, 3000]),
)
def test_a_block_is_as_its_messages_one_by_one(tmp_path_factory, seed, most, longest):
    """Also among single messages, over the ends of chunks, and where the first message is not of the first topic."""
    folder, files = tmp_path_factory.mktemp("bags"), list[bytes]()
    for way in (write_messages, one_by_one):
        dice, path = np.random.default_rng(seed), Path(folder, way.__name__, "out.mcap")
        with BagWriter(path) as bag:
            for topic, name in zip(RECORDED, NAMES, strict=True):
                bag.add_topic(name, MESSAGE_TYPES[topic])
            for _ in range(3):
                way(bag, rows_of(dice, most, longest))
                if dice.random() < 0.5:
                    bag.write_message(NAMES[0], 5, bytes(70_000 * dice.integers(2)))
                if dice.random() < 0.3:
                    bag.file.flush()
        files.append(path.read_bytes() + path.with_name("metadata.yaml").read_bytes())
    assert files[0] == files[1]
