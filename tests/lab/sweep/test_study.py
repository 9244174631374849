"""What a study may ask, how its cases are numbered, and what is refused."""

from __future__ import annotations

import itertools
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from knee_contact_ros.lab.study import LARGEST, Study, read_study
from knee_contact_ros.system.errors import UsageError

VALUES = {"contact.damping": (0.0, 1e3, 2e3), "femur.mass": (1.0, 2.0, 3.0), "fidelity.tolerance": (1e-8, 1e-7, 1e-6)}
grids = st.dictionaries(st.sampled_from(list(VALUES)), st.integers(1, 3), max_size=3)


@settings(max_examples=30)
@given(bags=st.integers(1, 3), knees=st.integers(1, 2), grid=grids, points=st.integers(0, 5))
def test_every_case_stands_once_and_the_last_name_changes_soonest(
    bags: int, knees: int, grid: dict[str, int], points: int
) -> None:
    allowed = {name: list(VALUES[name][:number]) for name, number in grid.items()}
    content: dict[str, Any] = {
        "bags": [f"{i}.mcap" for i in range(bags)], "params": ["healthy", "osteoarthritis"][:knees], "grid": allowed,
    }  # fmt: skip
    if points:
        content["sample"] = {"n": points, "ranges": {"contact.stiffness": [5e7, 1e8]}}
    asked = Study(content)
    cases = [asked.case(number) for number in range(asked.number)]
    drawn = [case.values["contact.stiffness"] for case in cases[:points]] if points else [None]
    found = [
        (case.bag, *case.params, *(case.values[name] for name in allowed), case.values.get("contact.stiffness"))
        for case in cases
    ]
    assert found == list(itertools.product(content["bags"], content["params"], *allowed.values(), drawn))


def drawn(**sample: Any) -> np.ndarray:
    """The points of a sample."""
    asked = Study({"bags": ["a"], "sample": sample})
    return np.array([list(asked.case(i).values.values()) for i in range(asked.number)])


@pytest.mark.parametrize("method", ["sobol", "random"])
@settings(max_examples=30)
@given(few=st.integers(1, 40), more=st.integers(1, 40), seed=st.integers(0, 2**31))
def test_a_sample_that_has_grown_begins_with_the_same_points(method: str, few: int, more: int, seed: int) -> None:
    ranges = {"contact.damping": [1e3, 1e4], "femur.mass": {"from": 1.0, "to": 10.0, "scale": "log"}}
    longer = drawn(method=method, n=few + more, seed=seed, ranges=ranges)
    assert (longer[:few] == drawn(method=method, n=few, seed=seed, ranges=ranges)).all()
    assert (longer >= [1e3, 1.0]).all()
    assert (longer <= [1e4, 10.0]).all()


GRID = {"contact.damping": [0.0, 1.0]}
REFUSED: dict[str, dict[str, Any]] = {
    "bags: is missing": {"bags": None},
    "bags: a is given twice": {"bags": ["a", "a"]},
    "params: ['healthy'] is given twice": {"params": ["healthy", "healthy"]},
    "nonsense: is not known": {"nonsense": 1},
    "unknown parameter contact.dampin; did you mean contact.damping?": {"grid": {"contact.dampin": [1]}},
    "contact.damping: [] is not allowed": {"grid": {"contact.damping": []}},
    "contact.damping: 7 is not allowed": {"grid": {"contact.damping": 7}},
    "contact.damping: -1.0 is not allowed": {"grid": {"contact.damping": [-1.0, 1.0]}},
    "a value stands there twice": {"grid": {"contact.damping": [1.0, 1.0]}},
    "contact.damping is given twice": {"grid": GRID, "values": {"contact.damping": 1.0}},
    "record.path is not allowed": {"grid": {"record.path": ["a.mcap", "b.mcap"]}},
    "from 2 to 1: from < to is asked": {"grid": {"femur.mass": {"from": 2, "to": 1}}},
    "n: 0 is not allowed": {"sample": {"n": 0, "ranges": {"femur.mass": [1, 2]}}},
    "ranges: {} is not allowed": {"sample": {"n": 2, "ranges": {}}},
    "femur.mass: [1] is not allowed": {"sample": {"n": 2, "ranges": {"femur.mass": [1]}}},
    "method: 'dice' is not allowed": {"sample": {"n": 2, "method": "dice", "ranges": {"femur.mass": [1, 2]}}},
    f"{LARGEST} at most": {"bags": ["a", "b"], "sample": {"n": LARGEST, "ranges": {"femur.mass": [1, 2]}}},
    "nobody.yaml: cannot read": {"params": ["nobody.yaml"]},
}


@pytest.mark.parametrize("said", REFUSED)
def test_what_is_refused_is_named(said: str) -> None:
    content = {name: value for name, value in ({"bags": ["a"]} | REFUSED[said]).items() if value is not None}
    with pytest.raises(UsageError) as told:
        Study(content, "my.yaml")
    assert said in str(told.value)
    assert str(told.value).startswith("my.yaml: ")
    assert "\n" not in str(told.value)


def test_a_study_file_that_is_none(tmp_path: Path) -> None:
    path = tmp_path / "study.yaml"
    for text in ("", "- a", "{", "bags: &a [*a]"):
        path.write_text(text)
        with pytest.raises(UsageError, match=r"study\.yaml: "):
            read_study(path)
    with pytest.raises(UsageError, match=r"nobody\.yaml: cannot read the study"):
        read_study(tmp_path / "nobody.yaml")
