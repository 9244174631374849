"""A study on a real scheduler: one table, however it came about."""

from __future__ import annotations

import os
import shutil
import threading
import time
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pyarrow.parquet as pq
import pytest

import knee_contact_ros
from knee_contact_ros.lab import run_study
from knee_contact_ros.lab.run_study import Shards, compute_block
from knee_contact_ros.system.errors import IncompleteError, UsageError
from tests.lab.sweep.studies import DAMPINGS, assert_same, computed, left_over, study, table

pytestmark = pytest.mark.xdist_group("cluster of cohorts")
GRID = {"contact.damping": DAMPINGS, "contact.layer_depth": [3e-4, 5e-4, 7e-4, 9e-4]}


def test_the_table_is_that_of_single_runs(right_bag: Path, address: str, tmp_path: Path) -> None:
    asked = study(right_bag, params=["healthy", "osteoarthritis"], grid=GRID)
    assert computed(asked, tmp_path / "out", scheduler=address) == (0, 40, 0, ())
    found = table(tmp_path / "out")
    assert len(found) == 40
    assert set(found["params"]) == {"healthy", "osteoarthritis"}
    for _, row in found.iloc[::13].iterrows():
        values = {name: row[name] for name in GRID}
        alone = knee_contact_ros.solve(right_bag, row["params"], values)
        assert row["peak_force"] == alone.contact_force.max()
        assert row["peak_depth"] == alone.penetration_depth.max()
        assert row["bag"] == str(right_bag)
    assert pq.read_schema(next((tmp_path / "out").glob("cases-*"))).field("peak_force").metadata


def test_processes_of_our_own_give_the_same_table_however_many(right_bag: Path, address: str, tmp_path: Path) -> None:
    asked = study(right_bag, grid=GRID)
    computed(asked, tmp_path / "theirs", scheduler=address)
    expected = table(tmp_path / "theirs")
    for workers in (1, 2):
        folder = tmp_path / str(workers)
        assert computed(asked, folder, workers=workers).computed == 20
        assert_same(table(folder), expected)
        names = [sorted(path.name for path in place.glob("cases-*")) for place in (folder, tmp_path / "theirs")]
        assert names[0] == names[1]


@pytest.mark.parametrize("values", [{}, {"load.compartment": "both"}], ids=["one", "both"])
def test_the_bits_do_not_depend_on_the_size_of_the_blocks(
    values: dict[str, Any], right_bag: Path, address: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    ranges = {"contact.stiffness": [5e7, 1e8], "contact.damping": [0.0, 8e3], "contact.tibial_radius": [0.03, 0.09]}
    asked = study(right_bag, values=values, sample={"method": "sobol", "n": 300, "ranges": ranges})
    tables = []
    for size in (300, 7, 64):
        monkeypatch.setattr(run_study, "_size_of_block", lambda _knee, size=size: size)
        folder = tmp_path / str(size)
        assert computed(asked, folder, scheduler=address)[:3] == (0, 300, 0)
        assert len(list(folder.glob("cases-*"))) == -(-300 // size)
        tables.append(table(folder))
    assert_same(tables[0], tables[1])
    assert_same(tables[0], tables[2])


def test_a_study_that_has_grown_computes_only_what_is_new(right_bag: Path, address: str, tmp_path: Path) -> None:
    small = study(right_bag, grid={"contact.damping": DAMPINGS[:3]})
    large = study(right_bag, grid={"femur.mass": [8.0, 9.3014], "contact.damping": DAMPINGS})
    assert computed(small, tmp_path / "out", scheduler=address)[:2] == (0, 3)
    assert computed(large, tmp_path / "out", scheduler=address)[:2] == (3, 7)
    assert computed(small, tmp_path / "out", scheduler="tcp://127.0.0.1:1")[:2] == (3, 0)  # nobody is asked
    computed(large, tmp_path / "at once", scheduler=address)
    assert_same(table(tmp_path / "out"), table(tmp_path / "at once"))


def test_the_same_bag_under_two_names_is_computed_once(right_bag: Path, address: str, tmp_path: Path) -> None:
    shutil.copytree(right_bag, tmp_path / "copy")
    asked = study(right_bag, grid={"contact.damping": DAMPINGS})
    asked.bags = (str(right_bag), str(tmp_path / "copy"))
    assert computed(asked, tmp_path / "out", scheduler=address)[:2] == (5, 5)
    assert len(table(tmp_path / "out")) == 5


def test_two_clients_share_a_folder(right_bag: Path, address: str, tmp_path: Path) -> None:
    """Of one study they seldom compute the same; of two that overlap, each case stands in the table once."""
    ranges = {"contact.damping": [1e3, 1e4]}
    one = study(right_bag, sample={"method": "sobol", "n": 300, "ranges": ranges})
    more = study(right_bag, sample={"method": "sobol", "n": 420, "ranges": ranges})
    done: list[Any] = []
    clients = [
        threading.Thread(target=lambda asked=asked: done.append(computed(asked, tmp_path / "out", scheduler=address)))
        for asked in (one, one, more)
    ]
    for client in clients:
        client.start()
    for client in clients:
        client.join()
    assert len(done) == 3
    found = table(tmp_path / "out")  # which asserts that there is none twice
    assert len(found) == 420
    computed(more, tmp_path / "alone", scheduler=address)
    assert_same(found, table(tmp_path / "alone"))


def test_failed_cases_are_rows_with_a_reason(right_bag: Path, address: str, tmp_path: Path) -> None:
    asked = study(right_bag, values={"tibia.geometry": "circle"}, grid={"tibia.radius": [0.02, 0.03, 0.09]})
    assert computed(asked, tmp_path / "out", scheduler=address)[:3] == (0, 3, 2)
    found = table(tmp_path / "out").sort_values("tibia.radius", ignore_index=True)
    assert found["failed"][0] == (
        "parameter tibia.radius: 0.02 is not allowed; it must exceed femur.radius, 0.034"
    )  # fmt: skip
    assert list(found["failed"] == "") == [False, False, True]
    assert list(found["peak_force"].isna()) == [True, True, False]
    assert computed(asked, tmp_path / "out", scheduler=address)[:2] == (3, 0)


def test_series_of_both_compartments(address: str, right_bag: Path, tmp_path: Path) -> None:
    """They come later, too: then the cases are computed again."""
    content: dict[str, Any] = {"params": ["both_compartments"], "grid": {"contact.damping": DAMPINGS[:2]}}
    assert computed(study(right_bag, **content), tmp_path / "out", scheduler=address)[:2] == (0, 2)
    before = table(tmp_path / "out")
    asked = study(right_bag, series=True, **content)
    assert computed(asked, tmp_path / "out", scheduler=address)[:2] == (0, 2)
    assert computed(asked, tmp_path / "out", scheduler=address)[:2] == (2, 0)
    assert_same(table(tmp_path / "out"), before)
    series = pd.read_parquet(tmp_path / "out" / "_series")
    for _, row in before.iterrows():
        values = {"contact.damping": row["contact.damping"]}
        medial = knee_contact_ros.solve(right_bag, "both_compartments", values)
        assert medial.lateral is not None
        for side, alone in (("medial", medial), ("lateral", medial.lateral)):
            own = series[(series["case"] == row["case"]) & (series["compartment"] == side)]
            assert (own["contact_force"].to_numpy() == alone.contact_force).all()
            assert (own["stamp"].to_numpy() == np.asarray(alone["stamp"])).all()
        assert row["peak_force"] == medial.contact_force.max()
        assert row["lateral_peak_force"] == medial.lateral.contact_force.max()


@pytest.mark.parametrize("way", ["file", "zip", "folder"])
def test_data_are_read_where_they_lie(way: str, right_bag: Path, address: str, tmp_path: Path) -> None:
    (file,) = right_bag.glob("*.mcap")
    with zipfile.ZipFile(tmp_path / "gait.zip", "w") as archive:
        archive.write(file, "gait.mcap")
    bags = {
        "file": f"file://{file}", "folder": f"file://{right_bag}", "zip": f"zip://gait.mcap::file://{tmp_path}/gait.zip"
    }  # fmt: skip
    grid = {"contact.damping": DAMPINGS[:2]}
    assert computed(study(bags[way], grid=grid), f"file://{tmp_path}/out", scheduler=address)[:2] == (0, 2)
    computed(study(file if way != "folder" else right_bag, grid=grid), tmp_path / "plain", scheduler=address)
    assert_same(table(tmp_path / "out").drop(columns="bag"), table(tmp_path / "plain").drop(columns="bag"))


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
    found = table(tmp_path / "out")
    assert (found["failed"] == "").all()
    assert found["peak_force"].gt(1000.0).all()


@pytest.mark.parametrize(
    ("grid", "said"),
    [
        ({"femur.profile": ["nobody.csv"]}, "parameter femur.profile: cannot read nobody.csv: No such file"),
        ({"load.share_file": ["/nobody.csv"]}, "parameter load.share_file: cannot read /nobody.csv: No such file"),
    ],
)
def test_a_file_that_is_not_there_is_told_before_anything_is_made(
    grid: dict[str, Any], said: str, right_bag: Path, address: str, tmp_path: Path
) -> None:
    with pytest.raises(UsageError) as told:
        computed(study(right_bag, grid=grid), tmp_path / "out", scheduler=address)
    assert said in str(told.value)
    assert list(tmp_path.iterdir()) == []


def test_a_worker_with_another_model_is_refused(
    right_bag: Path, address: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(run_study, "what_answers", lambda: "another")
    with pytest.raises(UsageError, match=r"worker tcp://127\.0\.0\.1:\d+: another version of knee_contact_ros"):
        computed(study(right_bag, grid=GRID), tmp_path / "out", scheduler=address)
    assert list((tmp_path / "out").glob("cases-*")) == []


def test_a_worker_that_finds_another_bag_or_no_folder_is_refused(
    right_bag: Path, address: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with pytest.raises(UsageError, match=r"output memory://out: worker tcp://\S+ does not see this folder"):
        computed(study(right_bag, grid=GRID), "memory://out", scheduler=address)
    monkeypatch.setattr(run_study, "digest_of", lambda _bag, _path: "another")
    with pytest.raises(UsageError, match=r"gait2354_right: worker tcp://\S+ finds another content than the client"):
        computed(study(right_bag, grid=GRID), tmp_path / "out", scheduler=address)


def test_what_nobody_expects_is_told_in_a_line(
    right_bag: Path, address: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    computed(study(right_bag, grid=GRID), tmp_path / "out", scheduler=address)
    monkeypatch.setattr("knee_contact_ros.lab.run_study.compute_block", divide)
    with pytest.raises(IncompleteError) as told:
        computed(study(right_bag, values={"femur.mass": 2.0}, grid=GRID), tmp_path / "out", scheduler=address)
    assert "a worker failed: ZeroDivisionError: " in str(told.value)
    assert len(table(tmp_path / "out")) == 20
    assert compute_block is not divide


def divide(_block: Any) -> float:
    """Fails on the worker."""
    return 1 / len("")


def test_a_folder_of_others_a_foreign_table_and_a_damaged_one(right_bag: Path, address: str, tmp_path: Path) -> None:
    asked, out = study(right_bag, grid=GRID), tmp_path / "out"
    computed(asked, out, scheduler=address)
    expected, first = table(out), sorted(out.glob("cases-*"))[0]
    (out / "holiday.jpg").touch()
    with pytest.raises(UsageError, match=r"holds holiday\.jpg, which is none of a study's results"):
        computed(asked, out, scheduler=address)
    (out / "holiday.jpg").unlink()
    pd.DataFrame({"a": [1]}).to_parquet(out / "cases-mine.parquet")
    with pytest.raises(UsageError, match=r"cases-mine\.parquet is damaged, or none of a study's results"):
        computed(asked, out, scheduler=address)
    (out / "cases-mine.parquet").unlink()
    whole = first.read_bytes()
    for damage in (b"", whole[:100], whole[: len(whole) // 2]):
        first.write_bytes(damage)
        with pytest.raises(UsageError) as told:
            computed(asked, out, scheduler=address)
        assert f"{first.name} is damaged" in str(told.value)
        assert "\n" not in str(told.value)
    first.unlink()
    assert computed(asked, out, scheduler=address)[1] > 0
    assert_same(table(out), expected)
    (tmp_path / "file").touch()
    with pytest.raises(UsageError, match="it is no folder"):
        computed(asked, tmp_path / "file", scheduler=address)


def test_what_was_left_unfinished_long_ago_is_removed(right_bag: Path, address: str, tmp_path: Path) -> None:
    (tmp_path / "out").mkdir()
    for name, age in (("_unfinished-a-b", 7200), ("_unfinished-c-d", 60)):
        (tmp_path / "out" / name).touch()
        os.utime(tmp_path / "out" / name, (1e9, time.time() - age))
    computed(study(right_bag, grid=GRID), tmp_path / "out", scheduler=address)
    assert left_over(tmp_path / "out") == ["_unfinished-c-d"]


def test_cases_that_stand_twice_are_united_and_those_with_series_stay(
    right_bag: Path, tmp_path: Path, address: str
) -> None:
    for values, series in ((DAMPINGS[:3], False), (DAMPINGS[1:], True), (DAMPINGS, False)):
        folder = tmp_path / f"{len(values)} {series}"
        computed(study(right_bag, grid={"contact.damping": values}, series=series), folder, scheduler=address)
        shutil.copytree(folder, tmp_path / "out", dirs_exist_ok=True)
    Shards(str(tmp_path / "out")).unite()
    assert len(table(tmp_path / "out")) == 5
    assert pd.read_parquet(tmp_path / "out" / "_series")["case"].nunique() == 4
    assert len(Shards(str(tmp_path / "out")).finished(series=True)) == 4
