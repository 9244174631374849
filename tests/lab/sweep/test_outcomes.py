"""What a run comes to, beside the plain formulas over its series; and cases computed together beside single runs."""

import numpy as np
import pytest

from knee_contact_ros import UsageError, load_model, solve, sweep
from knee_contact_ros.lab.knees import Knees, compute
from knee_contact_ros.lab.outcomes import OUTCOMES
from knee_contact_ros.lab.recordings import Recording
from knee_contact_ros.model.types import FLAT, ContactState, Status
from knee_contact_ros.parameters.files import load_parameters
from tests.model.test_inputs import WEIGHT
from tests.model.test_inputs import gait as walk

PAUSE = 0.51
"""[s] of the bag's hole, longer than `gait_events.GAP`"""
TIME = np.cumsum(np.tile([0.004, 0.006, 0.005], 40)) + PAUSE * (np.arange(120) >= 70)
ANGLE = 0.4 + 0.3 * np.sin(7.0 * TIME)
LOAD = np.where((TIME > 0.2) & (TIME < 0.23), -150.0, 1400.0 + 1200.0 * np.sin(13.0 * TIME))
TWO_LAYERS = {"contact.law": "two_layer_viscoelastic"}
RESETS = (37, 38, 90)


def assert_outcomes(row, series, begins):
    """All outcomes are those of the plain formulas over a series with its model, whose runs begin where stated."""
    readouts, steps = series.readouts, np.diff(np.asarray(series["stamp"])) * 1e-9
    follows = ~np.isin(np.arange(1, len(series)), begins) & (steps < PAUSE)
    touching = np.asarray(series["contact_state"]) != ContactState.SEPARATED
    way = np.hypot(np.diff(series["contact_point"]["x"]), np.diff(series["contact_point"]["y"]))

    def over_time(values):
        values = np.asarray(values, dtype=float)
        return float((0.5 * steps * (values[1:] + values[:-1]))[follows].sum())

    found = {
        "peak_force": series["contact_force"].max(),
        "peak_depth": series["penetration_depth"].max(),
        "error_bound": series["error_estimate"].max(),
        "force_error_bound": series["force_error_estimate"].max(),
        "peak_pressure": readouts["peak_pressure"].max(),
        "peak_strain": readouts["strain"].max(),
        "not_converged": ((series["status"] & Status.NOT_CONVERGED) != 0).sum(),
        "ringing": np.abs(series.ringing).max(),  # what it is: tests/offline/test_gait.py
        "ticks": len(series),
        "implausible": ((series["status"] & Status.IMPLAUSIBLE) != 0).sum(),
        "evaluations": series["evaluations"].sum(),
        "impulse": over_time(series["contact_force"]),
        "contact_time": over_time(touching),
        "bone_time": over_time(np.asarray(series["contact_state"]) == ContactState.BONE),
        "peak_loading_rate": (np.diff(series["contact_force"]) / steps)[follows].max(),
        "path_length": way[follows & touching[1:] & touching[:-1]].sum(),
        "sliding_distance": over_time(np.abs(series["sliding_velocity"]) * touching),
    }
    assert set(found) == set(OUTCOMES)
    for (
        name,
        value,
    ) in found.items():  # sums of some hundred numbers, in another order: 1e-12 of them
        assert row[name] == pytest.approx(float(value), rel=1e-12, abs=1e-15), name


def bits(rows):
    """All of answers, but what is between the fields."""
    flat = np.asarray(rows).view(FLAT)
    return {name: np.ascontiguousarray(flat[name]).tobytes() for name in FLAT.names or ()}


def recording(resets=()):
    """The gait, which begins anew at some ticks."""
    stamps = np.rint(TIME * 1e9).astype(np.int64)
    steps = np.diff(stamps, prepend=stamps[:1]) * 1e-9
    steps[list(resets)] = 0.0
    return Recording(stamps, steps, ANGLE, LOAD, np.zeros_like(LOAD), np.full(len(TIME), np.nan))


@pytest.mark.parametrize(("threads", "compiled"), [(1, False), (2, True)])
def test_cases_have_the_bits_of_single_runs_with_time_resets(threads, compiled):
    total = {"load.compartment": "total"}
    knees = Knees(recording(RESETS), load_parameters(total), {})
    cases = [{"contact.damping": value, "fidelity.tolerance": 1e-7} for value in (0.0, 2e3, 5e4)]
    cases += [TWO_LAYERS, {"contact.stiffness": 1e7, "translation.mechanism": "ball_and_socket"}]
    computed = compute(knees, cases, series=True, threads=threads, compiled=compiled)
    for i, case in enumerate(cases):
        knee = load_model(total | case, compiled=False)
        parts = [
            knee.run(TIME[begin:end], ANGLE[begin:end], LOAD[begin:end])
            for begin, end in zip((0, *RESETS), (*RESETS, len(TIME)), strict=True)
        ]
        for part in parts[1:]:
            part["status"][0] |= Status.TIME_RESET
        whole = np.concatenate(parts)
        whole["stamp"] = recording().stamps
        assert bits(computed.series[0][i]) == bits(whole)
        series = whole.view(type(parts[0]))
        series.model = knee
        assert_outcomes(computed.outcomes[0][i], series, [0, *RESETS])
        assert computed.outcomes[0][i]["contact_time"] < TIME[-1] - TIME[0] - PAUSE  # it lifts off
        assert (computed.outcomes[0][i]["bone_time"] > 0.0) == (case == TWO_LAYERS)


STILL = {"time": [0.0, 0.01], "flexion_angle": [0.3, 0.3]}
LOADED = STILL | {"axial_load": [700.0, 700.0]}


@pytest.mark.parametrize(
    ("gait", "params", "said"),
    [
        (
            STILL,
            {},
            "need time, flexion_angle, axial_load and allow time, flexion_angle, axial_load, frontal_moment$",
        ),
        (LOADED | {"femoral_height": [0.0, 0.0]}, {}, "femoral_height is not allowed"),
        (LOADED, {"drive": "displacement"}, "need time, flexion_angle, femoral_height and allow"),
        (
            LOADED,
            {"load.compartment": "moment_balance"},
            "need time, flexion_angle, axial_load, frontal_moment",
        ),
        (
            STILL | {"axial_load": np.ma.masked_less([1.0, 7.0], 5.0)},
            {},
            "must be finite, and not masked",
        ),
    ],
)
def test_arrays_that_the_parameters_need_are_not_assumed(gait, params, said):
    with pytest.raises(UsageError, match=f"^gait: .*{said}"):
        sweep(gait, {"contact.damping": [1e3]}, params)


@pytest.mark.parametrize("muscles", [False, True])
def test_arrays_without_muscle_forces_are_doubted(muscles, recwarn):
    """The axial load is that of the whole knee, whatever part of it the model takes."""
    time, angle, load = walk()
    axial = load if muscles else 1.1 * WEIGHT * load / load.max()
    gait = {"time": time, "flexion_angle": angle, "axial_load": axial}
    knee = {"body_weight": WEIGHT}
    sweep(gait, {"contact.damping": [1e3]}, knee)
    assert ["the net joint force" in str(each.message) for each in recwarn] == [True] * (
        not muscles
    )


def test_a_case_whose_rule_needs_a_moment_fails_without_one():
    found = sweep(LOADED, {"load.compartment": ["total", "moment_balance"]})
    assert found.failed.tolist() == ["", "gait: load rule moment_balance needs frontal_moment"]


@pytest.mark.parametrize(
    ("params", "values"),
    [
        ("osteoarthritis", {"femur.mass": 8.0}),
        ("both_compartments", {"load.share": 0.6, "lateral.contact.damping": 1e3}),
    ],
)
def test_a_bag_gives_what_solve_does(params, values, right_bag):
    varied = values | {"contact.damping": [1e3, 5e3]}
    found = sweep(right_bag, varied, params, series=True)
    sides = [(found.outcomes, found.series)]
    if found.lateral is not None:
        sides.append((found.lateral, found.lateral_series))
    assert (len(sides) == 2) == (params == "both_compartments")
    for i, damping in enumerate(varied["contact.damping"]):
        medial = solve(right_bag, params, values | {"contact.damping": damping}, compiled=False)
        for (outcome, series), alone in zip(sides, (medial, medial.lateral), strict=False):
            alone["latency"] = 0.0
            assert bits(series[i]) == bits(alone)
            assert outcome.peak_force[i] == alone.contact_force.max()
    frame = found.to_pandas()
    assert all((frame[name] == value).all() for name, value in values.items())
    assert ("lateral_peak_force" in frame) == (len(sides) == 2)
    assert sweep(right_bag, varied, params).series is None
