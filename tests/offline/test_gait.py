"""Strides and cycles of answers as tables; and what of a difference between laws is none of the knees."""

import numpy as np
import pytest

pytest.importorskip("pandas", reason="needs the extra notebook")

from knee_contact_ros import UsageError, load_model, paired, solve
from knee_contact_ros.model.ringing import damped
from knee_contact_ros.streams.strides import RISE_TIME
from studies.reference import LAWS, Knee
from studies.reference import solve as solve_by_reference
from tests.helpers.needs import needs_compiler
from tests.helpers.scenes import DAMPING, LAYER_DEPTH, MASS, STIFFNESS
from tests.streams.test_gait_events import BODY_WEIGHT, STRIDE, walking

STRIDES = 6
LEVEL = 0.95


FINE = 50
"""Samples for one of the recorded rate, 200 Hz, that show the contact force where bone stops the femur"""
STOPPED_BY_BONE = 941.1
"""Mean difference [N/s] of the strides' loading rates by the reference, of samples at 10 kHz.

The femur's 9.3 kg go down at 4 mm/s when they touch bone, and 2 ms later the force exceeds the load by 21 N. It is 407
with half of the mass, and 0 at the quasi-static level. Samples at 200 Hz miss part of it, another one in every stride:
559, 145 to 972.
"""
SPRING = {"stiffness": STIFFNESS, "exponent": 1.5, "damping": DAMPING}
BY_REFERENCE = {
    "healthy": LAWS["kelvin_voigt"](**SPRING),
    "osteoarthritis": LAWS["two_layer_viscoelastic"](
        **SPRING, layer_depth=LAYER_DEPTH, stiffness_2=3.112e9, damp_first_layer=True
    ),
}


def inputs(speed, force, finer=1):
    """Time [s], angle and load of a made-up walk at parts of the shipped gait's speed and load; its steps vary."""
    stamps, angle, load = walking(200.0, (STRIDES + 1.5) * STRIDE)
    rng = np.random.default_rng(3)
    along = np.arange(len(stamps)) / 200.0 / STRIDE
    knots = np.arange(along[-1] + 2.0)
    vary = 1.0 + 0.03 * np.interp(along, knots, rng.normal(size=len(knots)))
    given = (stamps - stamps[0]) / 1e9 / speed, angle, force * vary * load
    samples = np.arange(len(stamps))
    between = np.arange((len(stamps) - 1) * finer + 1) / finer
    return [np.interp(between, samples, each) for each in given]


def walk(law, speed, force, finer=1):
    """Strides of such a walk."""
    gait = load_model(law).run(*inputs(speed, force, finer))
    return gait.strides(BODY_WEIGHT)


@pytest.mark.parametrize("finer", [1, FINE])
@pytest.mark.parametrize(
    ("speed", "force", "reaches_bone"), [(0.7, 0.45, False), (1.0, 1.0, True)]
)
def test_a_difference_is_told_where_bone_is_reached_and_nowhere_else(
    speed, force, reaches_bone, finer
):
    """The shipped arthritic knee above bone is the healthy one: no loading rate, force or depth differs."""
    healthy, worn = (walk(law, speed, force, finer) for law in BY_REFERENCE)
    assert len(healthy) == len(worn) >= STRIDES
    difference = paired(healthy, worn, LEVEL)
    for name in ("loading_rate", "peak_force", "stance_impulse", "peak_depth"):
        assert difference.loc[name, "low"] <= difference.loc[name, "high"]
    contains_0 = (difference.low <= 0.0) & (difference.high >= 0.0)
    assert contains_0.loading_rate != reaches_bone
    assert contains_0.peak_depth != reaches_bone
    assert (difference.loc["peak_depth", "high"] < -1e-4) == reaches_bone
    assert (worn.ringing == 0.0).all()
    rates = difference.loc["loading_rate"]
    true = STOPPED_BY_BONE if reaches_bone else 0.0
    assert rates.low <= true <= rates.high
    if finer == FINE:
        # Two forces by 0.6 mN off, their largest error estimate here, over the rise time; the number has one digit
        assert rates.difference == pytest.approx(true, abs=2.0 * 6e-4 / RISE_TIME + 0.05)


@needs_compiler
def test_the_difference_where_bone_is_reached_is_that_of_the_reference():
    """An own solver, laws and rate: the force's rise over 20 ms in the first half of each stance, at 10 kHz."""
    time, angle, load = inputs(1.0, 1.0, FINE)
    stances = walk("healthy", 1.0, 1.0)
    rise = round(RISE_TIME * 200.0 * FINE)
    rates = []
    for law in BY_REFERENCE.values():
        found = solve_by_reference(Knee(law, MASS), time, angle, load)
        assert found.force_bound.max() < 1e-6
        halves = [
            (time >= begin) & (time <= 0.5 * (begin + end))
            for begin, end in zip(stances.heel_strike, stances.toe_off, strict=True)
        ]
        forces = [found.force[half] for half in halves]
        rates.append([(force[rise:] - force[:-rise]).max() / RISE_TIME for force in forces])
    apart = np.subtract(*reversed(rates))
    # Printed with one digit; rates of single strides are 844 to 1018
    assert apart.mean() == pytest.approx(STOPPED_BY_BONE, abs=0.1)


def test_as_printed_the_same_walk_shows_a_difference_that_its_ringing_covers():
    healthy, printed = (walk(law, 0.7, 0.45) for law in ("healthy", "osteoarthritis_as_printed"))
    difference = paired(healthy, printed, LEVEL)
    assert difference.loc["loading_rate", "low"] > 0.0  # what was taken for a disease
    assert (printed.ringing > 1.0).all()
    assert (
        np.abs(printed.loading_rate - healthy.loading_rate) <= 2.0 * printed.ringing / 0.02
    ).all()


def test_cycles_are_the_answers_at_percents_of_cycle_and_stance():
    gait = solve("bags/gait2354_right")
    (stride,) = gait.strides().itertuples()
    cycles, stance = gait.cycles(), gait.cycles(11, of="stance")
    assert cycles.index.names == stance.index.names == ["stride", "percent"]
    assert len(cycles) == 101
    assert len(stance) == 11
    for table, end in ((cycles, stride.heel_strike + stride.duration), (stance, stride.toe_off)):
        times = np.linspace(stride.heel_strike, end, len(table))
        for name in ("load", "penetration_depth"):
            # Stamps of strides are whole nanoseconds
            assert table[name].to_numpy() == pytest.approx(
                np.interp(times, gait.time, gait[name]), rel=1e-6
            )
    assert cycles.attrs["units"]["penetration_depth"] == "m"
    assert not {"status", "stamp", "run"} & {*cycles.columns}
    assert gait.strides().attrs["units"]["impulse"] == "N s"
    with pytest.raises(UsageError, match="points 1, of 'swing' is not allowed"):
        gait.cycles(1, of="swing")
    own = load_model().run(gait.time, gait.flexion_angle, gait.load)
    with pytest.raises(UsageError, match="body_weight"):
        own.strides()
    assert own.strides(BODY_WEIGHT).equals(gait.strides())
    assert own[:50].cycles(body_weight=BODY_WEIGHT).empty


@pytest.mark.parametrize(
    ("values", "rings"),
    [
        ({}, False),
        ({"contact.damping": 300.0}, True),
        ({"contact.law": "hertz"}, True),
        ({"contact.law": "hunt_crossley"}, False),
        ({"contact.law": "hunt_crossley", "contact.restitution": 1.0}, True),
        ({"contact.law": "two_layer_elastic"}, True),
        ({"contact.law": "two_layer_viscoelastic"}, True),
        ({"contact.law": "two_layer_viscoelastic", "contact.damp_first_layer": True}, False),
        ({"contact.law": "hertz", "fidelity.level": "quasi_static"}, False),
        ({"contact.law": "hertz", "drive": "displacement"}, False),
    ],
)
def test_laws_with_a_layer_that_is_hardly_damped_ring(values, rings):
    assert (damped(load_model(values)) is not None) == rings


def test_solve_tells_the_newtons_of_a_recorded_gait():
    with pytest.warns(
        UserWarning, match=r"rings by up to 38\.8 N: loading rate and largest force"
    ):
        printed = solve("bags/gait2354_right", "osteoarthritis_as_printed")
    worn = solve("bags/gait2354_right", "osteoarthritis")
    assert np.abs(printed.ringing).max() == pytest.approx(38.8, abs=0.1)
    # The dashpot for comparison is as strong as that of the shipped knee, by a two hundredth.
    assert printed.ringing == pytest.approx(printed.contact_force - worn.contact_force, abs=0.5)
    assert not worn.ringing.any()


def test_paired_differences_are_students():
    import pandas as pd

    first = pd.DataFrame({"depth": [1.0, 2.0, 4.0, np.nan], "name": [*"abcd"]})
    second = pd.DataFrame({"depth": [1.5, 2.0, 4.1, 9.0], "name": [*"abcd"]})
    row = paired(first, second).loc["depth"]
    assert row.difference == pytest.approx(0.2)
    assert row.n == 3
    # By hand: SD 0.2646 of 0.5, 0, 0.1; t(0.975, 2) = 4.3027
    assert row.high - row.difference == pytest.approx(4.302653 * 0.264575 / 3.0**0.5, rel=1e-5)
    with pytest.raises(UsageError, match="3 and 4 rows"):
        paired(first[:3], second)
    with pytest.raises(UsageError, match="level 1"):
        paired(first, second, 1.0)
