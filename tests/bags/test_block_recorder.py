"""Messages written as columns are, to the last byte, those written one by one."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from knee_contact_ros.bags.block_recorder import Messages, write_messages
from knee_contact_ros.bags.writer import BagWriter
from knee_contact_ros.streams.topics import MESSAGE_TYPES, RECORDED

NAMES = [f"/{topic}" for topic in RECORDED]


def rows_of(dice: np.random.Generator, most: int, longest: int) -> list[Messages]:
    """Up to so many messages of each topic, in any order and of any stamps; of some topics none."""
    rows = []
    for name in dice.permutation(NAMES).tolist():
        number = int(dice.integers(most + 1)) if dice.random() < 0.8 else 0
        stamps = 1_000_000 + dice.integers(-1000, 1000, number)
        data = dice.integers(256, size=(number, int(dice.integers(longest))), dtype=np.uint8)
        rows.append(Messages(name, stamps, data, np.sort(dice.integers(most + 1, size=number))))
    return rows


def one_by_one(bag: BagWriter, rows: list[Messages]) -> None:
    order = sorted((int(place), number, i) for number, row in enumerate(rows) for i, place in enumerate(row.place))
    for _, number, i in order:
        bag.write(rows[number].topic, int(rows[number].stamps[i]), rows[number].data[i].tobytes())


@settings(max_examples=25, deadline=None)
@given(seed=st.integers(0, 2**32 - 1), most=st.sampled_from([1, 5, 800]), longest=st.sampled_from([1, 300, 9000]))
def test_a_block_is_as_its_messages_one_by_one(
    tmp_path_factory: pytest.TempPathFactory, seed: int, most: int, longest: int
) -> None:
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
                    bag.write(NAMES[0], 5, bytes(70_000 * dice.integers(2)))
                if dice.random() < 0.3:
                    bag.flush()
        files.append(path.read_bytes() + path.with_name("metadata.yaml").read_bytes())
    assert files[0] == files[1]
