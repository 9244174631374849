"""Unit and sign of an angle: recognised where the data are clear, else asked for; what cannot be is refused."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from knee_contact_ros.lab.opensim.results import sign_of, unit_of
from knee_contact_ros.lab.tables import Storage
from knee_contact_ros.system.errors import UsageError


def storage(values: list[float], degrees: bool | None) -> Storage:
    return Storage(Path("q.sto"), ("a",), np.arange(len(values)), np.array(values)[:, None], degrees, 0)


@pytest.mark.parametrize(
    ("values", "header", "unit"),
    [([-69.0, 1.0], True, "deg"), ([-1.2, 0.02], False, "rad"), ([0.0, 60.0], None, "deg")],
)
def test_the_unit_is_recognised(values: list[float], header: bool | None, unit: str) -> None:
    assert unit_of(storage(values, header), "a", "auto") == unit


@pytest.mark.parametrize(
    ("values", "header", "says"),
    [
        ([-69.0, 1.0], False, "inDegrees=no, but a goes from -69 to 1, like degrees; give --angle-unit"),
        ([-1.2, 0.02], True, r"inDegrees=yes, but a goes from -1\.2 to 0\.02, like rad; give --angle-unit"),
        ([0.0, 1.2], None, r"does not say inDegrees, and a goes from 0 to 1\.2; give --angle-unit"),
    ],
)
def test_a_unit_that_is_not_clear_is_asked_for(values: list[float], header: bool | None, says: str) -> None:
    with pytest.raises(UsageError, match=says):
        unit_of(storage(values, header), "a", "auto")
    assert unit_of(storage(values, header), "a", "rad") == "rad"


@pytest.mark.parametrize(("degrees", "sign"), [([-69.0, 1.0], -1), ([-1.0, 69.0], 1), ([-12.0, 25.0], 1)])
def test_the_sign_is_that_to_which_it_goes_further(degrees: list[float], sign: int) -> None:
    assert sign_of(np.radians(degrees), "q.sto: a", None, None) == sign


def test_a_sign_that_is_not_clear_is_taken_from_the_model_or_asked_for() -> None:
    small = np.radians([-12.0, 15.0])
    with pytest.raises(UsageError, match=r"a goes from -12\.0 to 15\.0 deg: .* --angle-sign 1 or -1, or --model"):
        sign_of(small, "q.sto: a", None, None)
    assert sign_of(small, "q.sto: a", None, (-2.1, 0.17)) == -1
    assert sign_of(small, "q.sto: a", None, (0.0, 2.4)) == 1
    assert sign_of(small, "q.sto: a", -1, (0.0, 2.4)) == -1
    with pytest.raises(UsageError, match="--angle-sign"):
        sign_of(small, "q.sto: a", None, (-1.0, 1.0))


def test_a_wrong_sign_or_unit_cannot_be() -> None:
    with pytest.raises(UsageError, match=r"with sign \+1 that is -69\.0 to 1\.0 deg of flexion, .* -30 to 170"):
        sign_of(np.radians([-69.0, 1.0]), "q.sto: a", 1, None)
    with pytest.raises(UsageError, match="--angle-unit"):
        sign_of(np.array([0.0, 60.0]), "q.sto: a", None, None)  # degrees taken for rad
