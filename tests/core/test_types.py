"""Rows of answers, and their bytes."""

from __future__ import annotations

import numpy as np
import pytest

from knee_contact_ros.core.types import FLAT, ROW, blank, reader


@pytest.mark.parametrize("names", [("penetration_depth", "fidelity", "status"), FLAT.names])
def test_numbers_are_read_out_of_a_rows_bytes(names: tuple[str, ...]) -> None:
    rows = blank(1)
    for number, name in enumerate(FLAT.names or ()):
        rows.view(FLAT)[name] = number + 1
    told = reader(*names).unpack_from(rows.tobytes())
    assert told == tuple(rows.view(FLAT)[name].item() for name in names)
    assert len(set(told)) == len(names)


def test_a_blank_row_is_all_zeros() -> None:
    assert np.array_equal(blank(2).view(np.uint8), np.zeros(2 * ROW.itemsize, np.uint8))
