"""Splines beside SciPy's, and their bytes."""

import hashlib

import numpy as np
import pytest
from scipy.interpolate import CubicSpline

from knee_contact_ros.model.splines import NATURAL, NOT_A_KNOT, pieces_through


@pytest.mark.parametrize(
    ("ends", "scipys"),
    [(NOT_A_KNOT, "not-a-knot"), (NATURAL, "natural"), ((0.3, -2.0), ((1, 0.3), (1, -2.0)))],
    ids=str,
)
def test_a_spline_is_that_of_scipy(ends, scipys):
    """Widths over three decades. The tolerance is some thousand rounding errors of the largest value; 300 are seen."""
    dice = np.random.default_rng(1)
    for count in [*range(4, 12), 200]:
        x = np.cumsum(10.0 ** dice.uniform(-3.0, 0.0, count))
        y = dice.normal(size=count)
        pieces, spline = pieces_through(x, y, ends), CubicSpline(x, y, bc_type=scipys)
        places = np.linspace(x[:-1], x[1:], 7, axis=1)
        u = places - pieces[1:-1, :1]
        c0, c1, c2, c3 = pieces[1:-1, 1:, None].swapaxes(0, 1)
        expected = spline(places)
        found = c0 + u * (c1 + u * (c2 + u * c3))
        assert found == pytest.approx(expected, rel=0.0, abs=1e-12 * np.abs(expected).max())
        for row, end in ((0, 0), (-1, -1)):
            line = [x[end], y[end], float(spline(x[end], 1)), 0.0, 0.0]
            assert pieces[row] == pytest.approx(line, rel=1e-9)


def test_two_points_make_a_line():
    pieces = pieces_through(np.array([1.0, 3.0]), np.array([2.0, 8.0]), NATURAL)
    assert pieces.tolist() == [[1, 2, 3, 0, 0], [1, 2, 3, 0, 0], [3, 8, 3, 0, 0]]


def test_every_processor_gives_the_same_bytes():
    """The digest was the same on x86-64 and on aarch64, where SciPy's coefficients differ in one of four."""
    x = np.cumsum(1.0 + np.arange(40.0) % 7.0)
    y = 1.0 / (1.0 + x)
    pieces = pieces_through(x, y), pieces_through(x, y, NATURAL), pieces_through(x, y, (1.0, 0.5))
    digest = hashlib.sha256(np.stack(pieces).astype("<f8").tobytes()).hexdigest()
    assert digest == "63cb1c46673e051f7aae74bad303e17fd346723a53e2d814ce017894d7a8593d"
