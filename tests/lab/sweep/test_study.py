"""A study: what it may ask; on a real scheduler one table, however it came about; what is refused, in a line."""

import itertools
import re
import shutil
import socket
import subprocess
import warnings
import zipfile

import numpy as np
import pandas as pd
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from knee_contact_ros import solve, sweep, uncertainty
from knee_contact_ros.commands.main import main
from knee_contact_ros.lab import study as study_module
from knee_contact_ros.lab import study_cases
from knee_contact_ros.lab.outcomes import OUTCOMES
from knee_contact_ros.lab.shards import ShardFolder
from knee_contact_ros.lab.study import run_study
from knee_contact_ros.lab.study_cases import groups_of
from knee_contact_ros.lab.study_file import MAX_CASES, Sample, Study
from knee_contact_ros.system.errors import IncompleteError, UsageError
from tests import ROOT
from tests.lab.sweep.studies import DAMPINGS, assert_same, computed, started, study, table
from tests.offline.test_solve import make_bag

pytestmark = pytest.mark.xdist_group("cluster of cohorts")
GRID = {"contact.damping": DAMPINGS, "contact.layer_depth": [3e-4, 5e-4, 7e-4, 9e-4]}
TWO = {"contact.damping": DAMPINGS[:2]}
RADII = {"femur.radius": [0.033, 0.034]}
RANGES = {"contact.damping": [1e3, 1e4], "femur.mass": {"from": 1.0, "to": 10.0, "scale": "log"}}


def test_every_case_stands_once_and_the_last_name_changes_soonest():
    grid = {
        "contact.damping": [0.0, 1e3, 2e3],
        "femur.mass": {"from": 1.0, "to": 3.0, "number": 3},
    }
    sample = {"n": 4, "ranges": {"contact.stiffness": [5e7, 1e8]}}
    asked = Study(
        bags=["a", "b"],
        params=["healthy", ["healthy", "osteoarthritis"]],
        grid=grid,
        sample=sample,
    )
    assert asked.knees == list(
        itertools.product("ab", [("healthy",), ("healthy", "osteoarthritis")])
    )
    found = [tuple(values.values()) for values in asked.variants()]
    assert len(found) == asked.number / 4 == 36
    drawn = [values[2] for values in found[:4]]
    assert found == list(itertools.product((0.0, 1e3, 2e3), (1.0, 2.0, 3.0), drawn))


@pytest.mark.parametrize("method", ["sobol", "random"])
@settings(max_examples=30)
@given(few=st.integers(1, 40), more=st.integers(1, 40), seed=st.integers(0, 2**31))
def test_a_sample_that_has_grown_begins_with_the_same_points(method, few, more, seed):
    def drawn(n):
        design = Sample(method=method, n=n, seed=seed, ranges=RANGES)
        return design.points()

    longer = drawn(few + more)
    assert (longer[:few] == drawn(few)).all()
    assert (longer >= [1e3, 1.0]).all()
    assert (longer <= [1e4, 10.0]).all()


def test_the_table_is_that_of_single_runs_on_any_workers(right_bag, address, tmp_path):
    asked = study(right_bag, params=["healthy", "osteoarthritis"], grid=GRID)
    assert computed(asked, tmp_path / "theirs", scheduler=address) == (0, 40, 0)
    assert computed(asked, tmp_path / "ours", workers=1) == (0, 40, 0)
    found = table(tmp_path / "theirs")
    assert_same(found, table(tmp_path / "ours"))
    for _, row in found.iloc[::13].iterrows():
        with warnings.catch_warnings():
            # The depth of a layer has no effect under the law of the healthy knee.
            warnings.filterwarnings("ignore", "contact.layer_depth has no effect")
            values = {name: row[name] for name in GRID}
            alone = solve(right_bag, row["params"], values)
        assert row["peak_force"] == alone.contact_force.max()
        assert row["peak_depth"] == alone.penetration_depth.max()
        assert row["bag"] == str(right_bag)
    about = pd.read_parquet(tmp_path / "ours").attrs
    assert about["varied"] == sorted(GRID)
    assert about["units"]["peak_depth"] == "m"


def test_only_what_is_new_is_computed(right_bag, address, tmp_path):
    """A study that has grown, one that nobody is asked for, and a bag under two names."""
    small = study(right_bag, grid={"contact.damping": DAMPINGS[:3]})
    large = study(right_bag, grid={"femur.mass": [8.0, 9.3014], "contact.damping": DAMPINGS})
    assert computed(small, tmp_path / "out", scheduler=address)[:2] == (0, 3)
    assert computed(large, tmp_path / "out", scheduler=address)[:2] == (3, 7)
    assert computed(small, tmp_path / "out", scheduler="tcp://127.0.0.1:1")[:2] == (3, 0)
    computed(large, tmp_path / "at once", scheduler=address)
    assert_same(table(tmp_path / "out"), table(tmp_path / "at once"))
    shutil.copytree(right_bag, tmp_path / "copy")
    twice = Study(bags=[str(right_bag), str(tmp_path / "copy")], grid=TWO)
    assert computed(twice, tmp_path / "twice", scheduler=address)[:2] == (2, 2)


def test_failed_cases_are_rows_with_a_reason(right_bag, address, tmp_path):
    asked = study(
        right_bag, values={"tibia.geometry": "circle"}, grid={"tibia.radius": [0.02, 0.03, 0.09]}
    )
    assert computed(asked, tmp_path / "out", scheduler=address) == (0, 3, 2)
    found = table(tmp_path / "out").sort_values("tibia.radius", ignore_index=True)
    assert (
        found["failed"][0]
        == "parameter tibia.radius: 0.02 is not allowed; it must exceed femur.radius, 0.034"
    )
    assert list(found["failed"] == "") == [False, False, True]
    assert list(found["peak_force"].isna()) == [True, True, False]
    *numbers, missing = run_study(asked, str(tmp_path / "out"), scheduler=address)
    assert (numbers, missing) == ([3, 0, 2], f"2 of 3 cases failed: {found['failed'][0]}")


def test_a_damaged_or_implausible_bag_and_unused_parameters_lead_to_warnings(
    right_bag, address, tmp_path, capfd
):
    (file,) = right_bag.glob("*.mcap")
    damaged, upside_down, recorded = (
        tmp_path / f"{name}.mcap" for name in ("damaged", "upside_down", "recorded")
    )
    damaged.write_bytes(file.read_bytes()[: file.stat().st_size // 2])
    make_bag(upside_down, [(i * 10_000_000, 0.3, -1000.0) for i in range(300)])
    solve(right_bag, "osteoarthritis", output=recorded)
    asked, out = tmp_path / "study.yaml", str(tmp_path / "out")
    asked.write_text(f"bags: [{damaged}, {upside_down}, {recorded}]\n")
    last = f"knee-contact: bag {damaged} is damaged, and computed as far as it can be read: "
    doubts = {upside_down: "negative", recorded: "its own parameters are not used, but healthy"}
    for again in (False, True):
        assert main(["sweep", str(asked), "--output", out, "--scheduler", address]) == 1
        *warned, end = capfd.readouterr().err.splitlines()
        assert end.startswith(last)
        for bag, doubt in doubts.items():
            warnings = [
                line
                for line in warned
                if line.startswith(f"knee-contact: warning: bag {bag}: ") and doubt in line
            ]
            assert len(warnings) == (bag == recorded or not again)
    for bag, doubt in (
        doubts | {damaged: f"bag {damaged} is damaged, and solved as far as it can be read"}
    ).items():
        with pytest.warns(UserWarning, match=doubt):
            sweep(bag, TWO)
        if bag != recorded:
            with pytest.warns(UserWarning, match=doubt):
                uncertainty(bag, "healthy", {"axial_load": "5 %"})


def test_series_of_both_compartments(address, right_bag, tmp_path):
    out = tmp_path / "out"
    asked = study(right_bag, series=True, grid=TWO, params=["both_compartments"])
    assert computed(asked, out, scheduler=address)[:2] == (0, 2)
    assert computed(asked, out, scheduler=address)[:2] == (2, 0)
    series = pd.read_parquet(out / "_series")
    for _, row in table(out).iterrows():
        medial = solve(right_bag, "both_compartments", {"contact.damping": row["contact.damping"]})
        for side, alone in (("medial", medial), ("lateral", medial.lateral)):
            own = series[(series["case"] == row["case"]) & (series["compartment"] == side)]
            assert (own["contact_force"].to_numpy() == alone.contact_force).all()
            assert (own["stamp"].to_numpy() == np.asarray(alone["stamp"])).all()
        assert row["lateral_peak_force"] == medial.lateral.contact_force.max()
    next(
        out.glob("cases-*")
    ).unlink()  # a damaged one that is moved away: its series must not stay
    computed(
        study(right_bag, series=True, grid=TWO | RADII, params=["both_compartments"]),
        out,
        scheduler=address,
    )
    again = pd.read_parquet(out / "_series")
    assert len(again) == 2 * len(series)
    assert not again.duplicated(["case", "compartment", "stamp"]).any()
    computed(study(right_bag, grid=GRID), tmp_path / "without", scheduler=address)
    with pytest.raises(UsageError, match="holds cases without their series; use a new folder"):
        computed(study(right_bag, grid=GRID, series=True), tmp_path / "without", scheduler=address)


def test_data_are_read_where_they_lie(right_bag, address, tmp_path):
    (file,) = right_bag.glob("*.mcap")
    with zipfile.ZipFile(tmp_path / "gait.zip", "w") as archive:
        archive.write(file, "gait.mcap")
    for i, (there, plain) in enumerate(
        (
            (f"file://{right_bag}", right_bag),
            (f"zip://gait.mcap::file://{tmp_path}/gait.zip", file),
        )
    ):
        out, other = tmp_path / f"out{i}", tmp_path / f"plain{i}"
        assert computed(study(there, grid=TWO), f"file://{out}", scheduler=address)[:2] == (0, 2)
        computed(study(plain, grid=TWO), other, scheduler=address)
        assert_same(table(out).drop(columns="bag"), table(other).drop(columns="bag"))
    assert computed(study(right_bag, grid=TWO), "memory://cohorts/out", scheduler=address)[:2] == (
        0,
        2,
    )
    assert len(ShardFolder("memory://cohorts/out").read_columns("peak_force")) == 2


def test_workers_need_no_file_but_the_bag(config, right_bag, address, tmp_path, monkeypatch):
    """All names are relative to the client's folder, where no worker is; bag and output have their whole paths."""
    shutil.copytree(right_bag, tmp_path / "gait")
    for name in ("femur_medial.csv", "tibia_medial.csv"):
        shutil.copy(config / name, tmp_path / f"my_{name}")
    (tmp_path / "mine.yaml").write_text(
        "knee_contact: {ros__parameters: {femur: {geometry: profile, profile: my_femur_medial.csv}}}"
    )
    monkeypatch.chdir(tmp_path)
    grid = {
        "contact.damping": DAMPINGS[:2],
        "femur.profile": ["my_femur_medial.csv", "femur_medial.csv"],
    }
    assert computed(study("gait", params=["mine.yaml"], grid=grid), "out", scheduler=address) == (
        2,
        2,
        0,
    )
    grid = {"tibia.geometry": ["circle", "profile"], "tibia.profile": ["my_tibia_medial.csv"]}
    assert computed(study("gait", grid=grid), "tibia", scheduler=address) == (0, 2, 0)
    assert table(tmp_path / "out")["peak_force"].gt(1000.0).all()


def divide(_block):
    """Fails on the worker."""
    return 1 / len("")


@pytest.mark.parametrize(
    ("patched", "output", "error", "said"),
    [
        (
            (study_cases, "answers_version", lambda: "another"),
            "out",
            UsageError,
            r"worker tcp://127\.0\.0\.1:\d+ has another version",
        ),
        (
            (study_cases, "bag_digest", lambda _path: "another"),
            "out",
            UsageError,
            r"worker tcp://\S+ finds different content",
        ),
        (
            (study_module, "compute_block", divide),
            "out",
            IncompleteError,
            "a worker failed: ZeroDivisionError: ",
        ),
        ((study_cases, "MIN_BLOCK", 8), "nothing://out", UsageError, "output nothing://out: "),
    ],
)
def test_what_workers_cannot_do_is_one_line(
    patched,
    output,
    error,
    said,
    right_bag,
    address,
    tmp_path,
    monkeypatch,
):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(*patched)
    with pytest.raises(error, match=said):
        computed(study(right_bag, grid=GRID), output, scheduler=address)
    assert list(tmp_path.rglob("cases-*")) == []


def test_an_address_of_an_unknown_kind_ends_at_once_and_leaves_the_settings_of_dask():
    """In a process that has not used Dask before: a later study there needs the settings that it adds."""
    code = (
        "from dask import config; from knee_contact_ros.lab.study import dask_client; import contextlib\n"
        "from knee_contact_ros.system.errors import UsageError\n"
        "with contextlib.suppress(UsageError), dask_client(1, 'nonsense://1'): pass\n"
        "print(config.get('distributed.comm.timeouts.connect'))"
    )
    process = started("-c", code, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    assert process.communicate(timeout=60) == ("30s\n", "")


def test_a_folder_of_others_a_foreign_table_and_a_damaged_one(right_bag, address, tmp_path):
    asked, out = study(right_bag, grid=GRID), tmp_path / "out"
    computed(asked, out, scheduler=address)
    expected, first = table(out), min(out.glob("cases-*"))
    whole = first.read_bytes()
    last = len(whole) - 9 - int.from_bytes(whole[-8:-4], "little")  # the last byte of data
    foreign = tmp_path / "foreign.parquet"
    pd.DataFrame({"a": [1]}).to_parquet(foreign)
    for name, content, said in (
        ("holiday.jpg", b"", r"holds holiday\.jpg, which is not a result of a study"),
        (
            "cases-mine.parquet",
            foreign.read_bytes(),
            r"cases-mine\.parquet is damaged, or is not a result of a study",
        ),
        *(
            (first.name, whole[:size], f"{first.name} is damaged")
            for size in (0, 100, len(whole) // 2)
        ),
        (
            first.name,
            whole[:last] + bytes([whole[last] ^ 1]) + whole[last + 1 :],
            f"{first.name} is damaged",
        ),
    ):
        (out / name).write_bytes(content)
        with pytest.raises(UsageError, match=said):
            computed(asked, out, scheduler=address)
        (out / name).unlink()
    (out / "_unfinished").write_bytes(whole[:100])  # of one that was killed
    assert computed(asked, out, scheduler=address)[1] > 0
    assert_same(table(out), expected)
    with pytest.raises(UsageError, match=r"foreign\.parquet: is a file; a folder is needed"):
        computed(asked, foreign, scheduler=address)


def keys_of(bag, **content):
    """The keys of all cases."""
    asked = study(bag, **content)
    return [group.key(values) for group in groups_of(asked) for values in asked.variants()]


def test_what_a_knee_is_and_no_name_or_spelling_makes_the_key(right_bag, config, tmp_path):
    mri, other = (config / "femur_medial.csv").read_text(), tmp_path / "copy"
    shutil.copytree(right_bag, other)
    for name, text in (("a.csv", mri), ("b.csv", mri), ("c.csv", mri.rstrip("\n") + "\n\n")):
        (tmp_path / name).write_text(text)
    curve = {"params": ["mri_femur"]}
    same = [  # in each list all are the same case, and those of two lists are not
        [
            {},
            {"values": {"record.path": "a.mcap"}},
            {"values": {"rerun.mode": "serve"}},
            {"bag": other},
            {"values": {"lateral.contact.damping": 1.0}},
        ],
        [{"values": {"contact.damping": 4000.0}}, {"grid": {"contact.damping": [4000]}}],
        [
            curve,
            *(
                {**curve, where: {"femur.profile": value}}
                for name in ("a.csv", "b.csv")
                for where, value in (
                    ("values", str(tmp_path / name)),
                    ("grid", [str(tmp_path / name)]),
                )
            ),
        ],
        [{**curve, "values": {"femur.profile": str(tmp_path / "c.csv")}}],
        [{"values": {"load.compartment": "both"}}],
        *(
            [{"values": {name: value}}]
            for name, value in (
                ("contact.damping", 4000.000000000001),
                ("drive", "displacement"),
                ("load.share", 0.6),
                ("body_weight", 700.0),
                ("contact.law", "hertz"),
                ("pairing.max_gap", 0.02),
            )
        ),
    ]
    found = [
        {keys_of(content.pop("bag", right_bag), **content)[0] for content in contents}
        for contents in same
    ]
    assert list(map(len, found)) == [1] * len(same)
    assert len(set.union(*found)) == len(same)
    (file,) = other.glob("*.mcap")
    file.write_bytes(file.read_bytes() + b"\0")
    assert keys_of(other) != keys_of(right_bag)


BAD = {
    "bags: is missing": "grid: {femur.mass: [1.0]}",
    "a with ['healthy'] is given twice": "bags: [a, a]",
    "unknown parameter contact.dampin; did you mean contact.damping?": "bags: [a]\ngrid: {contact.dampin: [1]}",
    "grid.contact.damping: 7 is not allowed": "bags: [a]\ngrid: {contact.damping: 7}",
    "contact.damping is given twice": "bags: [a]\ngrid: {contact.damping: [0.0]}\nvalues: {contact: {damping: 1.0}}",
    "record.path is not allowed": "bags: [a]\ngrid: {record.path: [a.mcap, b.mcap]}",
    "'to': 1} is not allowed; from < to": "bags: [a]\ngrid: {femur.mass: {from: 2, to: 1}}",
    "ranges.femur.mass: [1] is not allowed; a list of": "bags: [a]\nsample: {n: 2, ranges: {femur.mass: [1]}}",
    "method: 'dice' is not allowed": "bags: [a]\nsample: {n: 2, method: dice, ranges: {femur.mass: [1, 2]}}",
    f"{MAX_CASES} at most": f"bags: [a, a]\nsample: {{n: {MAX_CASES}, ranges: {{femur.mass: [1, 2]}}}}",
    "/nobody.mcap: No such file or directory": "bags: [nobody.mcap]",
    "bag file:///nobody.mcap: cannot be fetched: ": "bags: ['file:///nobody.mcap']",
    "parameter femur.profile: cannot read nobody.csv": "bags: [{bag}]\nparams: [mri_femur]\nvalues: "
    "{femur.profile: nobody.csv}",
}


@pytest.fixture
def file(tmp_path, right_bag, monkeypatch):
    """A study file; names are as from the project's folder."""
    monkeypatch.chdir(ROOT)
    path = tmp_path / "study.yaml"
    path.write_text(f"bags: [{right_bag}]\ngrid: {{contact.damping: [1.0e3, 2.0e3]}}\n")
    return path


def refused(capfd, study, *options):
    """What the command says that ends with code 2: one line; nothing is written."""
    assert main(["sweep", str(study), "--output", str(study.parent / "out"), *options]) == 2
    said, errors = capfd.readouterr()
    assert said == ""
    assert re.fullmatch(r"knee-contact: [^\n]+\n", errors)
    assert list(study.parent.iterdir()) == [study]
    return errors


@pytest.mark.parametrize("said", BAD)
def test_bad_studies(said, address, right_bag, file, capfd):
    file.write_text(BAD[said].replace("{bag}", str(right_bag)))
    assert said in refused(capfd, file, "--scheduler", address)


def test_a_scheduler_that_cannot_be_reached(file, capfd, monkeypatch):
    monkeypatch.setattr(study_module, "SCHEDULER_TIMEOUT", 1.0)
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))  # not listening
        for address in (
            f"tcp://127.0.0.1:{taken.getsockname()[1]}",
            "nonsense",
            "gopher://a:1",
            "tcp://127.0.0.1",
        ):
            assert f"scheduler {address}: cannot be reached" in refused(
                capfd, file, "--scheduler", address
            )


def test_the_page_lists_every_outcome_with_its_unit():
    page = (ROOT / "docs" / "how-to" / "many-knees.md").read_text(encoding="utf-8")
    assert all(f"| `{name}` | {unit} |" in page for name, unit in OUTCOMES.items())
