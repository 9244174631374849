"""A study on a real scheduler: one table, however it came about."""

from __future__ import annotations

import os
import shutil
import time
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

import knee_contact_ros
from knee_contact_ros.lab import run_study
from knee_contact_ros.lab.run_study import Plan, Shards
from knee_contact_ros.lab.study import Study
from knee_contact_ros.system.errors import IncompleteError, UsageError
from tests.lab.sweep.studies import DAMPINGS, assert_same, computed, left_over, study, table

pytestmark = pytest.mark.xdist_group("cluster of cohorts")
GRID = {"contact.damping": DAMPINGS, "contact.layer_depth": [3e-4, 5e-4, 7e-4, 9e-4]}
TWO = {"contact.damping": DAMPINGS[:2]}


def test_the_table_is_that_of_single_runs_on_any_workers(right_bag: Path, address: str, tmp_path: Path) -> None:
    asked = study(right_bag, params=["healthy", "osteoarthritis"], grid=GRID)
    assert computed(asked, tmp_path / "theirs", scheduler=address) == (0, 40, 0, ())
    assert computed(asked, tmp_path / "ours", workers=1) == (0, 40, 0, ())
    found = table(tmp_path / "theirs")
    assert_same(found, table(tmp_path / "ours"))
    shards = [sorted(path.name for path in (tmp_path / way).glob("cases-*")) for way in ("ours", "theirs")]
    assert shards[0] == shards[1]
    assert set(found["params"]) == {"healthy", "osteoarthritis"}
    for _, row in found.iloc[::13].iterrows():
        alone = knee_contact_ros.solve(right_bag, row["params"], {name: row[name] for name in GRID})
        assert row["peak_force"] == alone.contact_force.max()
        assert row["peak_depth"] == alone.penetration_depth.max()
        assert row["bag"] == str(right_bag)
    assert pq.read_schema(tmp_path / "ours" / shards[0][0]).field("peak_force").metadata
    assert pd.read_parquet(tmp_path / "ours").attrs == {"varied": sorted(GRID)}


def test_only_what_is_new_is_computed(right_bag: Path, address: str, tmp_path: Path) -> None:
    """A study that has grown, one that nobody is asked for, and a bag under two names."""
    small = study(right_bag, grid={"contact.damping": DAMPINGS[:3]})
    large = study(right_bag, grid={"femur.mass": [8.0, 9.3014], "contact.damping": DAMPINGS})
    assert computed(small, tmp_path / "out", scheduler=address)[:2] == (0, 3)
    assert computed(large, tmp_path / "out", scheduler=address)[:2] == (3, 7)
    assert computed(small, tmp_path / "out", scheduler="tcp://127.0.0.1:1")[:2] == (3, 0)
    computed(large, tmp_path / "at once", scheduler=address)
    assert_same(table(tmp_path / "out"), table(tmp_path / "at once"))
    shutil.copytree(right_bag, tmp_path / "copy")
    twice = Study({"bags": [str(right_bag), str(tmp_path / "copy")], "grid": TWO})
    assert computed(twice, tmp_path / "twice", scheduler=address)[:2] == (2, 2)
    rows = Shards(str(tmp_path / "twice")).rows([Plan(twice).key(twice.case(i)) for i in range(4)], TWO)
    assert rows["contact.damping"].tolist() == 2 * DAMPINGS[:2]
    with pytest.raises(IncompleteError, match="1 of 1 cases are not there"):
        Shards(str(tmp_path / "twice")).rows(["another"], TWO)


def test_failed_cases_are_rows_with_a_reason(right_bag: Path, address: str, tmp_path: Path) -> None:
    asked = study(right_bag, values={"tibia.geometry": "circle"}, grid={"tibia.radius": [0.02, 0.03, 0.09]})
    assert computed(asked, tmp_path / "out", scheduler=address)[:3] == (0, 3, 2)
    found = table(tmp_path / "out").sort_values("tibia.radius", ignore_index=True)
    assert found["failed"][0] == "parameter tibia.radius: 0.02 is not allowed; it must exceed femur.radius, 0.034"
    assert list(found["failed"] == "") == [False, False, True]
    assert list(found["peak_force"].isna()) == [True, True, False]
    assert computed(asked, tmp_path / "out", scheduler=address)[:2] == (3, 0)


def test_series_of_both_compartments(address: str, right_bag: Path, tmp_path: Path) -> None:
    """They come later, too: then the cases are computed again, and stand in the table once."""
    out = tmp_path / "out"
    knees: dict[str, Any] = {"params": ["both_compartments"]}
    assert computed(study(right_bag, grid={"contact.damping": DAMPINGS[:3]}, **knees), out, scheduler=address)[1] == 3
    before, asked = table(out), study(right_bag, series=True, grid=TWO, **knees)
    assert computed(asked, out, scheduler=address)[:2] == (0, 2)
    assert computed(asked, out, scheduler=address)[:2] == (2, 0)
    assert_same(table(out), before)
    series = pd.read_parquet(out / "_series")
    for _, row in before[before["contact.damping"] < DAMPINGS[2]].iterrows():
        medial = knee_contact_ros.solve(right_bag, "both_compartments", {"contact.damping": row["contact.damping"]})
        assert medial.lateral is not None
        for side, alone in (("medial", medial), ("lateral", medial.lateral)):
            own = series[(series["case"] == row["case"]) & (series["compartment"] == side)]
            assert (own["contact_force"].to_numpy() == alone.contact_force).all()
            assert (own["stamp"].to_numpy() == np.asarray(alone["stamp"])).all()
        assert row["peak_force"] == medial.contact_force.max()
        assert row["lateral_peak_force"] == medial.lateral.contact_force.max()


def test_data_are_read_where_they_lie(right_bag: Path, address: str, tmp_path: Path) -> None:
    (file,) = right_bag.glob("*.mcap")
    with zipfile.ZipFile(tmp_path / "gait.zip", "w") as archive:
        archive.write(file, "gait.mcap")
    for i, (there, plain) in enumerate(
        ((f"file://{file}", file), (f"file://{right_bag}", right_bag),
         (f"zip://gait.mcap::file://{tmp_path}/gait.zip", file))
    ):  # fmt: skip
        out, other = tmp_path / f"out{i}", tmp_path / f"plain{i}"
        assert computed(study(there, grid=TWO), f"file://{out}", scheduler=address)[:2] == (0, 2)
        computed(study(plain, grid=TWO), other, scheduler=address)
        assert_same(table(out).drop(columns="bag"), table(other).drop(columns="bag"))


def test_workers_need_no_file_but_the_bag(
    config: Path, right_bag: Path, address: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """All names are relative to the client's folder, where no worker is; bag and output are told in full."""
    shutil.copytree(right_bag, tmp_path / "gait")
    for name in ("femur_medial.csv", "tibia_medial.csv"):
        shutil.copy(config / name, tmp_path / f"my_{name}")
    (tmp_path / "mine.yaml").write_text(
        "knee_contact: {ros__parameters: {femur: {geometry: profile, profile: my_femur_medial.csv}}}"
    )
    monkeypatch.chdir(tmp_path)
    grid = {"contact.damping": DAMPINGS[:2], "femur.profile": ["my_femur_medial.csv", "femur_medial.csv"]}
    assert computed(study("gait", params=["mine.yaml"], grid=grid), "out", scheduler=address)[:3] == (2, 2, 0)
    grid = {"tibia.geometry": ["circle", "profile"], "tibia.profile": ["my_tibia_medial.csv"]}
    assert computed(study("gait", grid=grid), "tibia", scheduler=address)[:3] == (0, 2, 0)
    assert table(tmp_path / "out")["peak_force"].gt(1000.0).all()


@pytest.mark.parametrize(
    ("patched", "output", "said"),
    [
        (("what_answers", lambda: "another"), "{}/out", r"worker tcp://127\.0\.0\.1:\d+: another version of knee_con"),
        (("bag_digest", lambda _path: "another"), "{}/out", r"gait2354_right: worker tcp://\S+ finds another content"),
        (("LEAST", 8), "memory://out", r"output memory://out: worker tcp://\S+ does not see this folder"),
        (("LEAST", 8), "nothing://out", "output nothing://out: "),
        (("LEAST", 8), "s3://nobody/out", "output s3://nobody/out: "),
    ],
)  # fmt: skip
def test_other_models_bags_and_folders_are_refused(
    patched: tuple[str, Any], output: str, said: str, right_bag: Path, address: str, tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:  # fmt: skip
    monkeypatch.setattr(run_study, *patched)
    with pytest.raises(UsageError, match=said):
        computed(study(right_bag, grid=GRID), output.format(tmp_path), scheduler=address)
    assert list(tmp_path.rglob("cases-*")) == []


def divide(_block: Any) -> float:
    """Fails on the worker."""
    return 1 / len("")


def test_what_nobody_expects_is_told_in_a_line(
    right_bag: Path, address: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    computed(study(right_bag, grid=TWO), tmp_path / "out", scheduler=address)
    monkeypatch.setattr(run_study, "compute_block", divide)
    with pytest.raises(IncompleteError, match="a worker failed: ZeroDivisionError: "):
        computed(study(right_bag, values={"femur.mass": 2.0}, grid=TWO), tmp_path / "out", scheduler=address)
    assert len(table(tmp_path / "out")) == 2


def test_a_folder_of_others_a_foreign_table_and_a_damaged_one(right_bag: Path, address: str, tmp_path: Path) -> None:
    asked, out = study(right_bag, grid=GRID), tmp_path / "out"
    out.mkdir()
    for name, age in (("_unfinished-a-b", 7200), ("_unfinished-c-d", 60)):
        (out / name).touch()
        os.utime(out / name, (1e9, time.time() - age))
    computed(asked, out, scheduler=address)
    assert left_over(out) == ["_unfinished-c-d"]
    expected, first = table(out), min(out.glob("cases-*"))
    whole = first.read_bytes()
    foreign = tmp_path / "foreign.parquet"
    pd.DataFrame({"a": [1]}).to_parquet(foreign)
    for name, content, said in (
        ("holiday.jpg", b"", r"holds holiday\.jpg, which is none of a study's results"),
        ("cases-mine.parquet", foreign.read_bytes(), r"cases-mine\.parquet is damaged, or none of a study's results"),
        *((first.name, whole[:size], f"{first.name} is damaged") for size in (0, 100, len(whole) // 2)),
    ):
        (out / name).write_bytes(content)
        with pytest.raises(UsageError, match=said) as told:
            computed(asked, out, scheduler=address)
        assert "\n" not in str(told.value)
        (out / name).unlink()
    assert computed(asked, out, scheduler=address)[1] > 0
    assert_same(table(out), expected)
    with pytest.raises(UsageError, match="it is no folder"):
        computed(asked, foreign, scheduler=address)


def test_in_memory_or_elsewhere_it_is_a_folder_as_well() -> None:
    ours = Shards("memory://cohorts/out")
    ours.make("_study", "{}")
    ours.write(pa.table({"case": ["a"]}), pa.table({"case": ["a"]}))
    ours.sweep_up()
    assert len(ours.names()) == 1
    assert Shards("memory://cohorts/out").finished("_series") == Shards("memory://cohorts/out").finished() == {"a"}


def keys_of(bag: Path, **content: Any) -> list[str]:
    """The keys of all cases."""
    asked = study(bag, **content)
    return list(map(Plan(asked).key, map(asked.case, range(asked.number))))


def test_what_a_knee_is_and_no_name_or_spelling_makes_the_key(right_bag: Path, config: Path, tmp_path: Path) -> None:
    mri, other = (config / "femur_medial.csv").read_text(), tmp_path / "copy"
    shutil.copytree(right_bag, other)
    for name, text in (("a.csv", mri), ("b.csv", mri), ("c.csv", mri.rstrip("\n") + "\n\n")):
        (tmp_path / name).write_text(text)
    own = "knee_contact:\n  ros__parameters:\n    contact:\n      damping: "
    for name, text in (("a.yaml", f"{own}4000.0\n"), ("b.yaml", f"# mine\n{own}4.0e3\n")):
        (tmp_path / name).write_text(text)
    curve: dict[str, Any] = {"params": ["mri_femur"]}
    same: list[list[dict[str, Any]]] = [  # in each list all are the same case, and those of two lists are not
        [{}, {"values": {"record.path": "a.mcap"}}, {"values": {"rerun.mode": "serve"}}, {"bag": other},
         {"values": {"lateral.contact.damping": 1.0}}],
        [{"values": {"contact.damping": 4000.0}}, {"grid": {"contact.damping": [4000]}},
         {"params": [str(tmp_path / "a.yaml")]}, {"params": [str(tmp_path / "b.yaml")]},
         {"params": [["healthy", str(tmp_path / "a.yaml")]]}],
        [curve, *({**curve, where: {"femur.profile": value}} for name in ("a.csv", "b.csv")
                  for where, value in (("values", str(tmp_path / name)), ("grid", [str(tmp_path / name)])))],
        [{**curve, "values": {"femur.profile": str(tmp_path / "c.csv")}}],
        [{"values": {"load.compartment": "both"}}],
        [{"values": {"load.compartment": "both", "lateral.contact.damping": 1.0}}],
        *([{"values": {name: value}}] for name, value in (
            ("contact.damping", 4000.000000000001), ("drive", "displacement"), ("load.share", 0.6),
            ("body_weight", 700.0), ("contact.law", "hertz"), ("pairing.max_gap", 0.02))),
    ]  # fmt: skip
    found = [{keys_of(content.pop("bag", right_bag), **content)[0] for content in contents} for contents in same]
    assert list(map(len, found)) == [1] * len(same)
    assert len(set.union(*found)) == len(same)
    (file,) = other.glob("*.mcap")
    file.write_bytes(file.read_bytes() + b"\0")
    assert keys_of(other) != keys_of(right_bag)
