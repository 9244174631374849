"""Columns of messages: the same messages whatever is done with the memory in which they lie."""

from __future__ import annotations

import numpy as np
import pytest

from knee_contact_ros.streams.columns import Column

MESSAGES = [b"one", b"", b"three", b"four", b"56789"]


def scattered() -> Column:
    """The same, not in the order of the memory, and with something else between them."""
    data = b"..four...one56789..three"
    begins = np.array([data.index(text) for text in MESSAGES])
    return Column(data, begins, begins + [len(text) for text in MESSAGES])


@pytest.mark.parametrize("column", [Column.of(MESSAGES), scattered(), scattered().trimmed()])
def test_messages_are_what_they_were(column: Column) -> None:
    assert list(column) == MESSAGES
    assert [column[index] for index in range(len(column))] == MESSAGES
    assert list(column.part(slice(1, 3))) == MESSAGES[1:3]
    assert list(column.part(np.array([4, 0]))) == [MESSAGES[4], MESSAGES[0]]
    assert list(Column.together([column, Column.of([]), column.part([2])])) == [*MESSAGES, MESSAGES[2]]
    long = column.part([0, 2, 3, 4])
    assert [row.tobytes() for row in long.rows(3)] == [b"one", b"thr", b"fou", b"567"]


def test_none_has_no_rows() -> None:
    assert Column.of([]).rows(8).shape == (0, 8)
