"""What makes a case another one, and what does not."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import Any

import pytest

from knee_contact_ros.lab import run_study
from knee_contact_ros.lab.run_study import Missing, Target, knees_of
from knee_contact_ros.lab.study import Study
from tests.lab.sweep.studies import DAMPINGS, study

TARGET = Target("", "", "", series=False, cases=1, answers="")
PARAMETERS = "knee_contact:\n  ros__parameters:\n    contact:\n      damping: 4000.0\n"


def keys_of(asked: Study) -> set[str]:
    """The keys of all cases."""
    return {key for block in Missing(asked, knees_of(asked), set(), TARGET) for key in block.keys}


def key_of(bag: Path, **content: Any) -> str:
    """The key of a single case."""
    (key,) = keys_of(study(bag, **content))
    return key


def test_a_comment_or_another_way_to_say_a_value_changes_nothing(right_bag: Path, tmp_path: Path) -> None:
    file = tmp_path / "own.yaml"
    file.write_text(PARAMETERS)
    first = key_of(right_bag, params=[str(file)])
    file.write_text("# my knee\n" + PARAMETERS)
    (tmp_path / "other.yaml").write_text(PARAMETERS.replace("4000.0", "4.0e3"))
    assert key_of(right_bag, params=[str(file)]) == first
    assert key_of(right_bag, params=[str(tmp_path / "other.yaml")]) == first
    assert key_of(right_bag, values={"contact.damping": 4000.0}) == first
    assert key_of(right_bag, grid={"contact.damping": [4000]}) == first
    assert key_of(right_bag, params=[["healthy", str(file)]]) == first


def test_a_value_changes_it(right_bag: Path) -> None:
    changed = (
        {"contact.damping": 4000.0}, {"contact.damping": 4000.000000000001}, {"drive": "displacement"},
        {"load.share": 0.6}, {"body_weight": 700.0}, {"contact.law": "hertz"}, {"pairing.max_gap": 0.02},
    )  # fmt: skip
    found = {key_of(right_bag, values=values) for values in changed} | {key_of(right_bag)}
    assert len(found) == len(changed) + 1


def test_where_is_recorded_or_shown_changes_nothing_nor_what_no_compartment_has(right_bag: Path) -> None:
    first = key_of(right_bag)
    for values in ({"record.path": "a.mcap"}, {"rerun.mode": "serve"}, {"lateral.contact.damping": 1.0}):
        assert key_of(right_bag, values=values) == first
    both = {"load.compartment": "both"}
    other = key_of(right_bag, values=both)
    assert key_of(right_bag, values=both | {"lateral.contact.damping": 1.0}) != other


def test_the_content_of_a_bag_and_no_name_of_it_makes_the_case(right_bag: Path, tmp_path: Path) -> None:
    copy = tmp_path / "copy"
    shutil.copytree(right_bag, copy)
    assert key_of(copy) == key_of(right_bag)
    file = next(copy.glob("*.mcap"))
    file.write_bytes(file.read_bytes() + b"\0")
    assert key_of(copy) != key_of(right_bag)


@pytest.mark.parametrize("varied", [False, True])
def test_the_content_of_a_profile_and_no_name_of_it_makes_the_case(
    right_bag: Path, config: Path, tmp_path: Path, varied: bool
) -> None:
    def key(name: str) -> str:
        own = {"grid": {"femur.profile": [name]}} if varied else {"values": {"femur.profile": name}}
        return key_of(right_bag, params=["mri_femur"], **own)

    own = tmp_path / "own.csv"
    text = (config / "femur_medial.csv").read_text()
    own.write_text(text)
    shutil.copy(own, tmp_path / "again.csv")
    first = key(str(own))
    assert key(str(tmp_path / "again.csv")) == first == key("femur_medial.csv")
    own.write_text(text.rstrip("\n") + "\n\n")
    assert key(str(own)) != first


def test_another_model_or_another_meaning_of_the_outcomes_makes_others(
    right_bag: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    first = key_of(right_bag)
    for name, value in (("model_digest", lambda: "another"), ("MEANING", 7)):
        with monkeypatch.context() as patch:
            patch.setattr(run_study, name, value)
            run_study.what_answers.cache_clear()
            assert key_of(right_bag) != first
    run_study.what_answers.cache_clear()


def test_refused_cases_of_two_knees_are_two(right_bag: Path) -> None:
    radii = {"tibia.radius": [0.01, 0.02]}
    asked = study(right_bag, values={"tibia.geometry": "circle"}, params=["healthy", "osteoarthritis"], grid=radii)
    assert len(keys_of(asked)) == asked.number == 4


def test_keys_of_a_grid_are_those_of_a_larger_one(right_bag: Path) -> None:
    small = keys_of(study(right_bag, grid={"contact.damping": DAMPINGS[:3]}))
    assert small < keys_of(study(right_bag, grid={"femur.mass": [9.3014, 1.0], "contact.damping": DAMPINGS}))


def test_all_clients_have_the_same_blocks_wherever_they_begin(right_bag: Path) -> None:
    asked = study(right_bag, sample={"n": 1000, "ranges": {"contact.damping": [0.0, 1e4]}})
    knees = knees_of(asked)
    ways = [[block.name for block in Missing(asked, knees, set(), TARGET)] for _ in range(4)]
    assert len({tuple(sorted(names)) for names in ways}) == 1
    assert len({tuple(names) for names in ways}) > 1
    done = {key for block in Missing(asked, knees, set(), TARGET) if block.name in ways[0][:9] for key in block.keys}
    assert sorted(block.name for block in Missing(asked, knees, set(done), TARGET)) == sorted(ways[0][9:])
