"""Rows of answers, and their bytes."""

import numpy as np
import pytest

from knee_contact_ros.model.types import (
    FLAT,
    MESSAGE_BYTES,
    ROW,
    WRENCH_BYTES,
    Point,
    answer_struct,
    blank_answers,
    unknown_answers,
)
from tests.helpers.scenes import law, model


@pytest.mark.parametrize("names", [("penetration_depth", "fidelity", "status"), FLAT.names])
def test_numbers_are_read_out_of_a_rows_bytes(names):
    rows = blank_answers(1)
    for number, name in enumerate(FLAT.names or ()):
        rows.view(FLAT)[name] = number + 1
    values = answer_struct(*names).unpack_from(rows.tobytes())
    assert values == tuple(rows.view(FLAT)[name].item() for name in names)


def test_a_blank_row_is_all_zeros_and_an_unknown_one_has_no_number():
    assert np.array_equal(blank_answers(2).view(np.uint8), np.zeros(2 * ROW.itemsize, np.uint8))
    rows = unknown_answers(2).view(FLAT)
    for name in FLAT.names or ():
        assert np.isnan(rows[name]).all() if FLAT[name].kind == "f" else (rows[name] == 0).all()


def test_a_row_holds_the_bytes_of_its_messages():
    """C aligns as CDR does, from any multiple of 8 B on; tests of the messages hold names and places to the .msg."""
    assert ROW.itemsize == FLAT.itemsize == ROW.itemsize // 8 * 8
    assert WRENCH_BYTES.start % 8 == 0
    assert (WRENCH_BYTES.stop - WRENCH_BYTES.start, MESSAGE_BYTES.start) == (48, 0)


def test_an_answer_consists_of_numbers_as_declared_and_prints_their_names():
    contact = model(law("kelvin_voigt")).stream().tick(0.0, 0.1, 800.0)
    assert (type(contact.status), type(contact.evaluations), type(contact.load)) == (
        int,
        int,
        float,
    )
    assert contact.evaluations - 1000 < 0  # which an unsigned number would not be
    assert (type(contact.contact_point), type(contact.contact_wrench.torque)) == (Point, Point)
    assert str(contact).startswith("(flexion_angle=0.1, load=800.0, contact_force=")
    assert "contact_point=(x=0.0, y=" in str(contact)
    assert repr(contact).startswith(
        "<Contact at 0 s: load 800.0 N, contact force 800.0 N, depth 0.468 mm>"
    )
