"""Batches of messages: cut and joined, they hold the same ones."""

from __future__ import annotations

import numpy as np
import pytest

from knee_contact_ros.bags.batch import Batch, blocks
from knee_contact_ros.streams.columns import Column

ROWS = [(number % 3, 7 * number % 40, b"%d" % number) for number in range(40)]


def batch(rows: list[tuple[int, int, bytes]]) -> Batch:
    numbers, times, messages = zip(*rows, strict=True)
    return Batch(np.array(numbers, np.intp), np.array(times, np.uint64), Column.of(messages))


def test_the_order_of_time_leaves_equal_times_as_they_are() -> None:
    rows = [(0, time // 4, data) for _, time, data in ROWS]
    assert list(batch(rows).by_time()) == sorted(rows, key=lambda row: row[1])


@pytest.mark.parametrize(("start", "stop"), [(None, None), (3, None), (None, 20), (-5, 10**20), (12, 12)])
def test_between_two_times(start: int | None, stop: int | None) -> None:
    expected = [row for row in ROWS if (start is None or row[1] >= start) and (stop is None or row[1] < stop)]
    assert list(batch(ROWS).between(start, stop)) == expected


def test_the_messages_of_a_topic_and_others_in_their_place() -> None:
    assert list(batch(ROWS).of(2)) == [data for number, _, data in ROWS if number == 2]
    changed = batch(ROWS).changed(lambda data: data * 2, batch(ROWS).numbers == 1)
    assert list(changed) == [(number, time, data * (1 + (number == 1))) for number, time, data in ROWS]


@pytest.mark.parametrize("most", [1, 3, 8, 39, 40, 41])
@pytest.mark.parametrize("sizes", [[40], [0, 5, 0, 35], [1] * 40, [17, 23]])
def test_blocks_are_of_one_size(most: int, sizes: list[int]) -> None:
    ends = np.cumsum(sizes).tolist()
    batches = [batch(ROWS).part(slice(end - size, end)) for size, end in zip(sizes, ends, strict=True)]
    found = list(blocks(batches, most))
    assert [row for block in found for row in block] == ROWS
    assert all(len(block) == most for block in found[:-1])
    assert 0 < len(found[-1]) <= most
