"""What a run's answers are in a notebook, and in other libraries."""

import json
import pickle
import re
import subprocess
import sys

import numpy as np
import pytest

import knee_contact_ros
from knee_contact_ros import Results, UsageError
from knee_contact_ros.model.types import FIELDS, FLAT
from knee_contact_ros.results import columns, unit_of
from tests import ROOT

TIME = np.arange(0.0, 0.5, 0.005)


@pytest.fixture(scope="module")
def results():
    """A model's, on a tibia that moves the place of contact."""
    model = knee_contact_ros.load_model({"tibia.slope": 0.1})
    run = model.run(TIME, 0.3 + 0.2 * np.sin(9.0 * TIME), 700.0 + 500.0 * np.sin(12.0 * TIME))
    assert isinstance(run, Results)
    return run


def test_they_are_the_same_record_array_with_more_to_it(results):
    assert isinstance(results, np.recarray)
    assert type(results.contact_force) is np.ndarray
    assert results.time == pytest.approx(TIME, abs=1e-12)
    assert (results["time"] == results.time).all()
    assert results.contact_point.x.shape == TIME.shape
    assert results[0].contact_force == results.contact_force[0]
    assert (results.stamp == np.rint(TIME * 1e9)).all()
    assert {"contact_force", "penetration_depth", "time", "to_pandas", "plot"} <= set(dir(results))


def test_parts_and_what_is_put_together_are_such_too(results):
    for part in (
        results[10:20],
        results[results.load > 700.0],
        pickle.loads(pickle.dumps(results)),  # noqa: S301
    ):
        assert isinstance(part, Results)
        assert len(part.time) == len(part)
    halves = [results[:40], results[40:]]
    for whole in (np.concatenate(halves), np.hstack(halves), np.append(*halves)):
        assert isinstance(whole, Results)
        assert repr(whole) == repr(results)
        assert (whole == results).all()
    assert type(np.concatenate([results.load, results.load])) is np.ndarray
    assert repr(results.contact_point[:1]).startswith(
        "rec.array([("
    )  # of NumPy: there is no time in it
    some = results[["stamp", "load"]]
    assert "700." in repr(some)
    assert str(some)
    assert results.contact_point._repr_html_() is some._repr_html_() is None


def test_some_fields_are_some_columns_of_their_own(results):
    some = columns(results[["stamp", "load", "contact_point"]])
    assert set(some) == {"time", "stamp", "load", *(f"contact_point_{axis}" for axis in "xyz")}
    assert (some["contact_point_x"] == results.contact_point.x).all()
    with pytest.raises(UsageError, match=r"^fields load: stamp must be one of them"):
        columns(results[["load"]])
    with pytest.raises(
        UsageError,
        match=r"^fields stamp, load: plot also needs flexion_angle, contact_force, penetr",
    ):
        results[["stamp", "load"]].plot()
    numbers = columns(results)
    numbers["load"][:] = 0.0
    assert results.load.min() > 0.0
    assert all(column.flags.c_contiguous and column.ndim == 1 for column in numbers.values())


def test_they_fit_a_line_and_a_terminal(results):
    assert re.fullmatch(
        r"<Results: 100 ticks over 0\.495 s, at most \d+\.\d N and 0\.\d+ mm>", repr(results)
    )
    lines = str(results).splitlines()
    assert len(lines) == 1 + 3 + 4 + 1 + 4
    assert max(map(len, lines)) <= 78
    first = results[0]
    numbers = (first.contact_force, 1e3 * first.penetration_depth, 1e3 * first.contact_point.x)
    texts = [f"{number:.{digits}f}" for number, digits in zip(numbers, (1, 3, 2), strict=True)]
    assert lines[4].split() == ["0.000", "17.2", "700.0", *texts, "OK"]
    assert results._repr_html_() == f"<pre>{results}</pre>"
    assert (repr(results[:0]), bool(str(results[:0]))) == ("<Results: no ticks>", True)
    assert len(str(results[:5]).splitlines()) == 1 + 3 + 5
    assert repr(results[:1]).startswith("<Results: 1 tick over 0.000 s, ")


def test_texts_are_short_and_a_wrong_name_suggests_the_right_one(right_bag):
    gait = knee_contact_ros.solve(right_bag)
    cohort = knee_contact_ros.sweep(right_bag, {"contact.damping": [1e3, 2e3]})
    sure = knee_contact_ros.uncertainty(right_bag, None, {"contact.stiffness": "20 %"})
    things = [
        gait,
        gait[["stamp", "load"]],
        gait.readouts,
        cohort,
        cohort.outcomes,
        sure,
        sure.medial,
    ]
    for thing in things:
        assert len(repr(thing).splitlines()) <= 20
    assert repr(cohort) == "<Cohort: 2 cases, 0 failed; varied: contact.damping 1000.0 to 2000.0>"
    assert re.search(
        r"at the largest force 1614\.1 ± 0\.\d+ N, 0\.747 ± 0\.1\d* mm, one standard dev",
        repr(sure.medial),
    )
    pairs = [
        (gait, "contact_forc"),
        (gait.readouts, "strian"),
        (cohort, "outcome"),
        (sure, "medail"),
    ]
    for thing, wrong in pairs:
        with pytest.raises(
            AttributeError, match=r"did you mean (contact_force|strain|outcomes|medial)\?"
        ):
            getattr(thing, wrong)


def assert_whole(names, column, results):
    """All numbers are there, bit for bit, and nothing but numbers."""
    flat = np.asarray(results).view(FLAT)
    assert list(names) == ["run", *(FLAT.names or ())]
    for name in FLAT.names or ():
        assert np.asarray(column(name)).tobytes() == np.ascontiguousarray(flat[name]).tobytes(), (
            name
        )


def test_pandas(results):
    pytest.importorskip("pandas")
    table = results.to_pandas()
    assert_whole(table.columns, table.__getitem__, results)
    assert table.index.name == "time"
    assert (table.index == results.time).all()
    assert all(kind.kind in "fiu" for kind in table.dtypes)


def test_polars_and_parquet(results, tmp_path):
    with pytest.raises(UsageError, match=r"whose names end in \.parquet"):
        results.to_parquet(tmp_path / "answers.csv")
    assert not list(tmp_path.iterdir())
    polars = pytest.importorskip("polars")
    table = results.to_polars()
    assert table.columns[0] == "time"
    assert_whole(table.columns[1:], table.__getitem__, results)
    results.to_parquet(tmp_path / "answers.parquet")
    assert polars.read_parquet(tmp_path / "answers.parquet").equals(table)
    about = polars.read_parquet_metadata(tmp_path / "answers.parquet")
    assert about["package"] == f"knee_contact_ros {knee_contact_ros.__version__}"
    assert json.loads(about["units"])["contact_point_x"] == "m"


def test_xarray_has_units(results):
    pytest.importorskip("xarray")
    data = results.to_xarray()
    assert_whole(list(data.data_vars), lambda name: data[name].values, results)
    assert (data.time.values == results.time).all()
    units = {"time": "s", "load": "N", "contact_point_x": "m", "status": None}
    assert {name: data[name].attrs.get("units") for name in units} == units
    about = knee_contact_ros.solve(ROOT / "bags" / "gait2354_right").to_xarray().attrs
    assert json.loads(about["parameters"])["contact.damping"] == 5000.0


def test_units_are_those_of_the_message():
    fields = re.findall(
        r"^\w[\w/]+ (\w+) +# (?:\[(.+?)\])?", (ROOT / "msg" / "KneeContact.msg").read_text(), re.M
    )
    units = {name: unit for name, unit in fields if name != "header"}
    assert len(units) > 12
    assert {name: unit_of(name if name in FIELDS else f"{name}_x") for name in units} == units
    assert unit_of("contact_wrench_torque_z") == "N m"


def test_the_figure_has_the_four_curves_and_stamps_of_today_count_from_the_first_one(
    results,
):
    pytest.importorskip("matplotlib")
    figure = results.plot()
    flexion, force, depth, point = figure.axes
    assert [len(axes.lines) for axes in figure.axes] == [1, 2, 1, 1]
    assert flexion.lines[0].get_ydata() == pytest.approx(np.degrees(results.flexion_angle))
    assert force.lines[1].get_ydata() == pytest.approx(results.contact_force)
    assert depth.lines[0].get_ydata() == pytest.approx(1e3 * results.penetration_depth)
    assert point.lines[0].get_xydata() == pytest.approx(
        np.stack([results.time, 1e3 * results.contact_point.x]).T
    )
    assert np.ptp(point.get_ylim()) > 1.99  # [mm] however little it moves
    assert {line.get_marker() for axes in results[:1].plot().axes for line in axes.lines} == {"o"}
    dated = results.copy()
    dated["stamp"] += 1_764_027_108_530_000_000
    _, origin, *lines = str(dated).splitlines()
    assert origin == "time from 1764027108.530 s on"
    assert (lines[3].split()[0], lines[-1].split()[0]) == ("+0.000", "+0.495")
    assert "…" not in "".join(lines[:7])  # nothing cut
    assert " +0.495 " in dated._repr_html_()
    assert dated.time[0] == pytest.approx(1_764_027_108.53, abs=1e-6)
    point = dated.plot().axes[-1]
    assert point.get_xlabel() == "time [s] from 1764027108.530 s on"
    assert point.lines[0].get_xdata() == pytest.approx(results.time)


ABSENT = """
import sys
import knee_contact_ros
results = knee_contact_ros.load_model().run([0.0], [0.3], [700.0])
ranges = {"contact.stiffness": (5e7, 1e8), "contact.damping": (2e3, 8e3)}
gait = {"time": [0.0, 0.1], "flexion_angle": [0.3, 0.3], "axial_load": [1e3, 1e3]}
cohort = knee_contact_ros.sweep(gait, {"contact.damping": [2e3]})
for name, call in (
    ("SALib", lambda: knee_contact_ros.sensitivity(gait, ranges)),
    ("pandas", lambda: results.to_pandas()),
    ("pandas", lambda: results.strides(700.0)),
    ("pandas", lambda: results.cycles(body_weight=700.0)),
    ("pandas", lambda: cohort.to_pandas()),
    ("pandas", lambda: knee_contact_ros.paired(1, 2)),
    ("polars", lambda: results.to_parquet("x.parquet")),
    ("xarray", lambda: results.to_xarray()),
    ("matplotlib", lambda: results.plot()),
    ("iminuit", lambda: knee_contact_ros.calibrate(
        {"time": [0.0, 0.1], "flexion_angle": [0.3, 0.3], "load": [1e3, 2e3], "penetration_depth": [1e-4, 2e-4]},
        free=["contact.stiffness"])),
):
    sys.modules[name] = None
    try:
        call()
    except knee_contact_ros.UsageError as error:
        print(error)
"""


def test_a_missing_library_is_named_in_a_line():
    printed = subprocess.run(
        [sys.executable, "-c", ABSENT], capture_output=True, text=True, check=True
    ).stdout
    names = ("SALib", *5 * ["pandas"], "polars", "xarray", "matplotlib", "iminuit")
    extras = ("sweep", *3 * ["notebook"], "sweep", *4 * ["notebook"], "calibrate")
    for line, name, extra in zip(printed.splitlines(), names, extras, strict=True):
        assert line.startswith(f"{name} is not installed; ")
        assert f"[{extra}]" in line


def test_parts_of_results_know_what_is_read_off_them(results):
    whole = results.readouts
    assert whole.peak_pressure.shape == results.shape
    assert results[20:30].readouts.half_width.tolist() == whole.half_width[20:30].tolist()
    assert results.model is not None
    assert results.model.readouts(results[:5]).strain.tolist() == whole.strain[:5].tolist()
    with pytest.raises(UsageError, match="the model of these answers is not known"):
        np.array(results).view(Results).readouts  # noqa: B018
