"""Two studies on one scheduler, cases that a study has twice, and what a case's key is made of."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pandas as pd
import pytest
from distributed import LocalCluster

from knee_contact_ros.lab.run_study import Shards, keys_of, run_study
from knee_contact_ros.lab.study import Spaced, Study, axes_of
from knee_contact_ros.system.errors import IncompleteError
from tests.helpers.bags import write_rosbag2
from tests.helpers.messages import raw_inputs


@pytest.fixture(scope="module")
def scheduler() -> Iterator[str]:
    """Workers in this process, to save their start."""
    with LocalCluster(
        n_workers=1, threads_per_worker=1, processes=False, protocol="tcp", host="127.0.0.1",
        dashboard_address="127.0.0.1:0", scheduler_kwargs={"dashboard": False},
    ) as cluster:  # fmt: skip
        yield cluster.scheduler_address


def study(bag: Path, *stiffness: float) -> Study:
    return Study({"bags": [str(bag)], "values": {"fidelity.level": "quasi_static"},
                  "grid": {"contact.stiffness": list(stiffness)}})  # fmt: skip


@pytest.fixture(scope="module")
def bag(tmp_path_factory: pytest.TempPathFactory, right_bag: Path) -> Path:
    return write_rosbag2(tmp_path_factory.mktemp("bag") / "short", raw_inputs(right_bag)[60:80])


def test_a_second_client_of_a_scheduler_computes_its_own_study(tmp_path: Path, bag: Path, scheduler: str) -> None:
    def meanwhile(_done: int, _all: int) -> None:  # the first client is still there
        second = study(bag, 6e7, 7e7)
        run_study(second, str(tmp_path / "second"), scheduler=scheduler, advance=lambda _done, _all: None)

    run_study(study(bag, 5e7), str(tmp_path / "first"), scheduler=scheduler, advance=meanwhile)
    assert pd.read_parquet(tmp_path / "first")["contact.stiffness"].tolist() == [5e7]
    assert sorted(pd.read_parquet(tmp_path / "second")["contact.stiffness"]) == [6e7, 7e7]


class Points(NamedTuple):
    """Some values of one parameter."""

    values: tuple[float, ...]

    @property
    def axes(self) -> dict[str, Spaced]:
        return axes_of({"contact.stiffness": [min(self.values), max(self.values)]})

    @property
    def number(self) -> int:
        return len(self.values)

    def points(self) -> np.ndarray:
        return np.array(self.values)[:, np.newaxis]


def test_a_case_that_a_study_has_twice_is_computed_once(tmp_path: Path, bag: Path, scheduler: str) -> None:
    content = {"bags": [str(bag)], "values": {"fidelity.level": "quasi_static"}}
    twice = Study(content, design=Points((5e7, 6e7, 5e7)))
    done = run_study(twice, str(tmp_path / "out"), scheduler=scheduler, advance=lambda _done, _all: None)
    assert (done.there, done.computed, done.failed) == (1, 2, 0)
    shards, keys = Shards(str(tmp_path / "out")), keys_of(twice)
    assert shards.rows(keys, ["contact.stiffness"])["contact.stiffness"].to_pylist() == [5e7, 6e7, 5e7]
    with pytest.raises(IncompleteError, match="1 of 4 cases are not there"):
        shards.rows([*keys, "another"], ["peak_depth"])


def test_a_file_that_a_value_names_is_part_of_the_key(tmp_path: Path, bag: Path, config: Path) -> None:
    curve = tmp_path / "femur.csv"
    text = (config / "femur_medial.csv").read_text()
    asked = Study({"bags": [str(bag)], "values": {"femur.profile": str(curve)},
                   "grid": {"femur.geometry": ["circle", "profile"]}})  # fmt: skip
    curve.write_text(text)
    circle, profile = keys_of(asked)
    curve.write_text(text + "\n# measured again")
    assert keys_of(asked)[0] == circle
    assert keys_of(asked)[1] != profile
    curve.unlink()
    assert len(keys_of(asked)) == 2  # the case will fail, and say why
