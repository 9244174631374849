"""Arguments that no function can use end in one line that names them, and never in a library's own error."""

import numpy as np
import pandas as pd
import pytest

from knee_contact_ros import (
    UsageError,
    calibrate,
    estimate_load,
    load_model,
    paired,
    sensitivity,
    solve,
    sweep,
    uncertainty,
)
from knee_contact_ros.model.arrays import InputError
from knee_contact_ros.streams.strides import strides_of
from tests import ROOT

TIME = np.linspace(0.0, 1.2, 61)
ANGLE, LOAD = 0.3 + 0.2 * np.sin(5.0 * TIME), 900.0 + 300.0 * np.sin(9.0 * TIME)
BAD = {
    "empty": [],
    "masked": np.ma.masked_array(TIME, mask=TIME[3] == TIME),
    "two_dimensions": TIME.reshape(1, -1),
    "texts": ["a"] * 61,
    "none": None,
    "objects": np.array([object()] * 61),
    "complex": TIME + 1j,
    "ragged": [[1.0, 2.0], [3.0]],
    "too_long": np.arange(70.0),
    "huge": [10**400] * 61,
    "mapping": {"a": 1},
    "durations": pd.to_timedelta(TIME, unit="s"),
}
GAIT = {"time": TIME, "flexion_angle": ANGLE, "axial_load": LOAD}
NET = {"time": TIME, "knee": ANGLE, "net_force": LOAD, "net_moment": 40.0 * ANGLE}
BAGS = [str(ROOT / "bags" / name) for name in ("gait2354_right", "gait2354_right_sensors")]
RANGES = {"contact.damping": [1e3, 2e3], "femur.mass": [8.0, 9.0]}
TABLE = pd.DataFrame({"a": [1.0, 2.0]})


@pytest.fixture(scope="module")
def knee():
    return load_model(compiled=False)


@pytest.fixture(scope="module")
def answers(knee):
    return knee.run(TIME, ANGLE, LOAD)


def fit(table=None, **how):
    measured = {
        "time": TIME,
        "flexion_angle": ANGLE,
        "load": LOAD,
        "penetration_depth": 1e-6 * LOAD,
    }
    how = {"free": ["contact.stiffness"], "with_intervals": False, "starts": 1} | how
    return calibrate(measured | (table or {}), **how)


CALLS = {
    "run time": lambda knee, answers, bad: knee.run(bad, ANGLE, LOAD),
    "run load": lambda knee, answers, bad: knee.run(TIME, ANGLE, bad),
    "tick time": lambda knee, answers, bad: knee.stream().tick(bad, 0.3, 800.0),
    "tick angle": lambda knee, answers, bad: knee.stream().tick(0.0, bad, 800.0),
    "advance": lambda knee, answers, bad: knee.stream().advance(bad, 0.3, 800.0),
    "readouts": lambda knee, answers, bad: knee.readouts(bad),
    "ringing": lambda knee, answers, bad: knee.ringing(bad),
    "strides": lambda knee, answers, bad: strides_of(bad, 700.0),
    "uncertainty of": lambda knee, answers, bad: knee.uncertainty(bad, 20.0),
    "cycles": lambda knee, answers, bad: answers.cycles(bad, body_weight=700.0),
    "to_parquet": lambda knee, answers, bad: answers.to_parquet(bad),
    "gait": lambda knee, answers, bad: sweep(GAIT | {"axial_load": bad}, {"femur.mass": [8.0]}),
    "values": lambda knee, answers, bad: sweep(GAIT, {"femur.mass": bad}),
    "threads": lambda knee, answers, bad: sweep(GAIT, {"femur.mass": [8.0]}, threads=bad),
    "sensitivity": lambda knee, answers, bad: sensitivity(bad, RANGES, n=8),
    "ranges": lambda knee, answers, bad: sensitivity(GAIT, RANGES | {"femur.mass": bad}, n=8),
    "outcomes": lambda knee, answers, bad: sensitivity(GAIT, RANGES, n=8, outcomes=bad),
    "net time": lambda knee, answers, bad: estimate_load(NET | {"time": bad}),
    "net moment": lambda knee, answers, bad: estimate_load(NET | {"net_moment": bad}),
    "sensors": lambda knee, answers, bad: estimate_load(bad),
    "mass": lambda knee, answers, bad: estimate_load(BAGS[1], values={"person.mass": bad}),
    "table": lambda knee, answers, bad: fit({"time": bad}),
    "level": lambda knee, answers, bad: fit(level=bad),
    "free": lambda knee, answers, bad: fit(free=bad),
    "bag": lambda knee, answers, bad: solve(bad),
    "namespace": lambda knee, answers, bad: solve(BAGS[0], namespace=bad),
    "deviations": lambda knee, answers, bad: uncertainty(
        BAGS[0], deviations={"contact.stiffness": bad}
    ),
    "paired": lambda knee, answers, bad: paired(bad, TABLE),
    "paired level": lambda knee, answers, bad: paired(TABLE, TABLE, bad),
}


@pytest.mark.filterwarnings("ignore::UserWarning")
@pytest.mark.parametrize("bad", BAD)
@pytest.mark.parametrize("call", CALLS)
def test_an_argument_that_cannot_be_used_ends_in_one_line(call, bad, knee, answers):
    with pytest.raises((UsageError, InputError)) as caught:
        CALLS[call](knee, answers, BAD[bad])
    assert "\n" not in str(caught.value)


def test_arrays_of_any_stride_are_taken(knee, answers):
    twice = np.repeat(TIME, 2)[::2], np.asfortranarray(np.column_stack([ANGLE, LOAD]))
    assert knee.run(twice[0], *twice[1].T).tobytes() == answers.tobytes()


def test_a_bag_with_too_long_a_name_is_refused_in_one_line():
    with pytest.raises(UsageError, match="no bag at aaa"):
        solve("a" * 5000)
