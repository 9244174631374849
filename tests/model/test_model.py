"""The model as users call it: against an independent solver, and the promises of its interface."""

import copy
import math
import pickle

import numpy as np
import pytest

from knee_contact_ros.model import (
    answers,
    contact,
    laws,
    lost_state,
    quasi_static,
    solver,
    statics,
)
from knee_contact_ros.model.knee import LARGEST_ANGLE, LARGEST_LOAD, MOST_BUDGET, KneeModel
from knee_contact_ros.model.laws import ContactLaw, Layer
from knee_contact_ros.model.types import ContactState, Fidelity, Status
from tests.helpers.scenes import RADIUS, law, model
from tests.model.scenes import PAIRS, ellipse, fast, hopping, signed

TICKS = np.arange(0.0, 0.4, 0.005)
ANGLE = 0.3 + 0.5 * np.sin(2 * np.pi * TICKS)
LOAD = 700.0 + 400.0 * np.sin(2 * np.pi * 3.0 * TICKS)
ROWS = list(zip(TICKS.tolist(), ANGLE.tolist(), LOAD.tolist(), strict=True))
FIELDS = (
    "contact_force",
    "penetration_depth",
    "gap",
    "penetration_rate",
    "femoral_height",
    "error_estimate",
)


@pytest.mark.parametrize("tolerance", [1e-6, 1e-8, 1e-10])
@pytest.mark.parametrize(
    ("scene", "name"),
    [
        ("gait2354_right_kelvin_voigt", "kelvin_voigt"),
        ("gait2354_right_two_layer", "two_layer_viscoelastic"),
        ("pull_apart_and_land", "kelvin_voigt"),
    ],
)
def test_independent_answers_are_met_to_the_tolerance(reference_data, scene, name, tolerance):
    path = reference_data / "reference" / f"{scene}.csv"
    reference = np.genfromtxt(path, delimiter=",", comments="#", skip_header=3, names=True)
    series = fast(model(law(name), tolerance)).run(
        reference["t"], reference["flexion_angle"], reference["load"]
    )
    error = np.abs(signed(series) - (RADIUS - reference["femoral_height"]))
    assert error.max() <= tolerance
    # The reference is given to 1e-14 m; the static start is exact on both sides.
    assert np.mean(error <= series.error_estimate + 1e-14) >= 0.98
    assert np.mean(series.status & Status.NOT_CONVERGED == 0) >= 0.6


@pytest.mark.parametrize("kind", PAIRS)
@pytest.mark.parametrize("name", ["kelvin_voigt", "two_layer_viscoelastic", "gonthier"])
def test_run_stream_and_compiled_code_give_the_same_bits(name, kind):
    """A whole series, one tick at a time, in blocks; plainly and compiled."""
    time, angle, load = hopping(60)
    knee = model(law(name), 1e-6, pair=PAIRS[kind](), budget=2000)
    bits = knee.run(time, angle, load).tobytes()
    for other in (knee, fast(knee)):
        stream, blocks = other.stream(), other.stream()
        rows = [
            stream.tick(*row).tobytes()
            for row in zip(time.tolist(), angle.tolist(), load.tolist(), strict=True)
        ]
        stamps = np.rint(time * 1e9).astype(np.int64)
        cut = np.split(np.arange(60), [7])
        parts = [blocks.advance_all(stamps[part], angle[part], load[part], None) for part in cut]
        assert b"".join(rows) == bits == other.run(time, angle, load).tobytes()
        assert b"".join(part.tobytes() for part in parts) == bits


def test_times_that_name_the_same_nanosecond_give_the_same_bits():
    stamps = np.arange(530_000_000, 730_000_000, 5_000_000)
    angle, load = np.linspace(0.1, 0.3, len(stamps)), np.linspace(300.0, 900.0, len(stamps))
    knee = model(law("kelvin_voigt"), 1e-6)
    times = (stamps / 1e9, stamps * 1e-9, stamps // 10**9 + (stamps % 10**9) * 1e-9)
    assert len({knee.run(time, angle, load).tobytes() for time in times}) == 1


def test_layers_share_the_depth():
    series = model(law("two_layer_viscoelastic")).run(TICKS, ANGLE, LOAD + 800.0)
    bone = series.contact_state == ContactState.BONE
    assert bone.any()
    assert np.array_equal(bone, series.penetration_depth > 5e-4)
    assert series.cartilage_depth + series.bone_depth == pytest.approx(
        series.penetration_depth, abs=1e-18
    )  # rounding
    assert (series.cartilage_depth <= 5e-4).all()


def test_the_contact_point_lies_on_the_plateau_under_the_lowest_point():
    series = model(law("kelvin_voigt"), geometry=ellipse(320)).run(TICKS, ANGLE, LOAD)
    a, b = 0.034, 0.028
    h = np.hypot(a * np.sin(ANGLE), b * np.cos(ANGLE))
    # the spline through 320 points of the ellipse, and no rounding
    assert series.contact_point.x == pytest.approx(
        -(a * a - b * b) * np.sin(ANGLE) * np.cos(ANGLE) / h, abs=1e-8
    )
    assert series.contact_point.y == pytest.approx(0.0, abs=1e-17)


def test_a_sloped_plateau_carries_the_load_by_its_normal_force():
    slope = 0.15
    last = model(law("kelvin_voigt"), slope=slope).run(
        TICKS, 0.0 * ANGLE, np.full_like(TICKS, 1000.0)
    )[-1]
    assert last.contact_force * math.cos(slope) == pytest.approx(1000.0, rel=1e-9)  # at rest
    assert last.contact_point.y / last.contact_point.x == pytest.approx(
        math.tan(slope), rel=1e-12
    )  # rounding
    assert (last.normal_x, last.normal_y) == pytest.approx(
        (-math.sin(slope), math.cos(slope)), rel=1e-15
    )
    # Distance of the reference point from the plateau: the radius less the depth.
    assert last.femoral_height * math.cos(slope) == pytest.approx(
        RADIUS - last.penetration_depth, abs=1e-15
    )
    # The wrench on the tibia at its origin
    force, torque = last.contact_wrench.force, last.contact_wrench.torque
    assert (force.x, force.y) == pytest.approx(
        (last.contact_force * math.sin(slope), -1000.0), rel=1e-9
    )
    assert torque.z == pytest.approx(
        last.contact_point.x * force.y - last.contact_point.y * force.x, rel=1e-12
    )
    assert (force.z, torque.x, torque.y) == (0.0, 0.0, 0.0)


@pytest.mark.parametrize("kind", PAIRS)
@pytest.mark.parametrize("apart", [-5e-4, 2e-3])
def test_sliding_is_that_of_the_femurs_material_point(kind, apart):
    """The point that is deepest at the tick, followed through the moments around it as a point of the femur."""
    pair, angle, rate, climb, tick = PAIRS[kind](), 0.42, 3.0, -0.05, 1e-3
    end = statics.height_at(pair.surfaces, angle, -apart, 0.1)
    knee = model(law("kelvin_voigt"), pair=pair, height_prescribed=True)
    row = knee.run(
        [0.0, tick], [angle - rate * tick, angle], [0.0, 0.0], [end - climb * tick, end]
    )[1]
    found = knee.pair.closest(angle, end)
    normal = np.array([found.normal_x, found.normal_y])
    tangent = np.array([normal[1], -normal[0]])
    arm = -found.extent * normal - found.turning * tangent

    def point(s):
        turn = rate * s
        turned = (
            np.array([[math.cos(turn), -math.sin(turn)], [math.sin(turn), math.cos(turn)]]) @ arm
        )
        return np.array([pair.mechanism.translation(angle + turn)[0], end + climb * s]) + turned

    step = 1e-5  # its square times third derivatives of some 1 m/s³: below 1e-9 m/s
    expected = float((point(step) - point(-step)) @ tangent) / (2.0 * step)
    assert row.sliding_velocity == pytest.approx(
        expected, abs=1e-7
    )  # the table's spline has kinks in x''
    assert (row.gap > 0.0) == (apart > 0.0)


@pytest.mark.filterwarnings("ignore:Warning. converting a masked element")
@pytest.mark.parametrize(
    ("time", "angle", "load", "words"),
    [
        (
            [0.0, 1.0],
            [0.0],
            [1.0, 1.0],
            "^time, flexion_angle and load must be one-dimensional and of equal length",
        ),
        ([[0.0]], [[0.0]], [[1.0]], "one-dimensional"),
        ([0.0, math.nan], [0.0, 0.0], [1.0, 1.0], "finite"),
        ([1e10], [0.1], [800.0], "time must be finite"),
        (
            [0.0, 1.0],
            [0.0, math.inf],
            [1.0, 1.0],
            "^flexion_angle and load must be finite, got inf, 1.0$",
        ),
        ([0.0], [0.1], np.ma.array([800.0], mask=True), "masked|must be finite"),
        ([0.0, 1.0], [0.0, 1e300], [1.0, 1.0], "must not exceed 10 rad"),
        (
            [0.0, 1.0],
            [0.0, 0.0],
            [1.0, -1e9],
            "must not exceed 10 rad and 1e\\+06 N, got 0.0, -1000000000.0$",
        ),
        ([0.0, 0.0], [0.0, 0.0], [1.0, 1.0], "increase"),
        ([1.0, 0.5], [0.0, 0.0], [1.0, 1.0], "increase"),
        ([1.0, 1.0 + 4e-10], [0.0, 0.0], [1.0, 1.0], "increase"),
    ],
)
def test_series_that_make_no_sense_are_refused(time, angle, load, words):
    knee = model(law("kelvin_voigt"))
    with pytest.raises(ValueError, match=words):
        knee.run(time, angle, load)
    if np.ndim(time) == 1 and len(angle) == len(time):
        stream, *rows, last = knee.stream(), *zip(time, angle, load, strict=True)
        for row in rows:
            stream.tick(*row)
        with pytest.raises(ValueError, match=words):
            stream.tick(*last)


def test_a_refused_tick_leaves_the_stream_as_it_was():
    knee, answers = model(law("kelvin_voigt")), []
    stream = knee.stream()
    for time, angle, load in ROWS:
        for wrong in (
            (time, math.nan, load),
            (time, angle, math.inf),
            (time - 1.0, angle, load),
            (math.nan, 0.0, 1.0),
        ):
            if len(answers) == 10:
                with pytest.raises(ValueError, match=r"finite|increase"):
                    stream.tick(*wrong)
        answers.append(stream.tick(time, angle, load))
    assert (
        b"".join(contact.tobytes() for contact in answers)
        == knee.run(TICKS, ANGLE, LOAD).tobytes()
    )
    stamps = np.array([10**9, 10**9], np.int64)
    with pytest.raises(ValueError, match="increase"):
        stream.advance_all(stamps, np.zeros(2), np.zeros(2), None)


def test_an_empty_series_gives_an_empty_answer_and_an_empty_law_none():
    assert len(model(law("kelvin_voigt")).run([], [], [])) == 0
    with pytest.raises(ValueError, match="first layer must begin at 0 m"):
        model(ContactLaw((Layer(1e-3, stiffness=1e6),)))


@pytest.mark.parametrize("level", ["dynamic", "quasi_static"])
@pytest.mark.parametrize("name", ["kelvin_voigt", "two_layer_viscoelastic", "flores"])
def test_every_evaluation_of_the_law_is_counted(name, level, monkeypatch):
    calls, force_at, touching = [0], laws.force_at, {laws.APART: 0}

    def counting(rows, layer, *rest):
        calls[0] += touching.get(layer, 1)  # apart there is nothing to evaluate
        return force_at(rows, layer, *rest)

    for module in (laws, answers, contact, lost_state, quasi_static, solver, statics):
        monkeypatch.setattr(module, "force_at", counting)
    load = np.where((TICKS > 0.1) & (TICKS < 0.12), -80.0, 2.0 * LOAD)
    series = model(law(name), 1e-7, level=level).run(TICKS, ANGLE, load)
    assert series.contact_state.min() == ContactState.SEPARATED or level == "quasi_static"
    # What finds out whether a lost contact has forgotten takes one or two, and is not counted
    assert abs(int(series.evaluations.sum()) - calls[0]) <= max(2 * len(TICKS), 0.1 * calls[0])


def test_a_budget_of_0_is_a_large_one_and_the_first_answer_is_the_static_one():
    assert model(law("hertz")).constants.budget == MOST_BUDGET >= 100_000
    first = model(law("kelvin_voigt")).stream().tick(0.0, 0.2, 1614.18)
    assert first.contact_force == pytest.approx(1614.18, rel=1e-12)  # rounding of the depth
    assert (first.penetration_rate, first.error_estimate, first.force_error_estimate) == (
        0.0,
        0.0,
        0.0,
    )
    assert (first.fidelity, first.status) == (Fidelity.DYNAMIC, Status.OK)


@pytest.mark.filterwarnings("ignore:the load reaches")
def test_what_is_deeper_than_plausible_is_said():
    knee = model(law("elastic_foundation"))
    assert knee.plausible_depth == 4.4e-3
    assert model(law("hertz")).plausible_depth == pytest.approx(
        0.2 * RADIUS, rel=1e-12
    )  # rounding of a fit
    for share, status in ((0.99, Status.OK), (1.01, Status.IMPLAUSIBLE)):
        assert knee.run([0.0], [0.0], [knee.law.static_force(share * 4.4e-3)]).status == status


def test_models_and_answers_are_copied_and_models_name_their_parts():
    knee = model(law("two_layer_elastic"), geometry=ellipse(40))
    assert repr(knee) == (
        "<KneeModel: profile on plane, hinge, contact law 7.906e+07 N/m^1.5 + 3.112e+09 N/m^1.5, force drive>"
    )
    again: KneeModel = pickle.loads(pickle.dumps(knee))  # noqa: S301  (our own)
    assert again.run(TICKS, ANGLE, LOAD).tobytes() == knee.run(TICKS, ANGLE, LOAD).tobytes()
    stream = knee.stream()
    first, other = stream.tick(0.25, 0.1, 800.0), knee.stream().tick(0.25, 0.1, 800.0)
    assert stream.tick(0.26, 0.1, 900.0) != first  # which the next tick leaves as it was
    assert first == other == pickle.loads(pickle.dumps(first)) == copy.copy(first)  # noqa: S301


@pytest.mark.filterwarnings("ignore:the load reaches", "ignore:the flexion angle goes")
@pytest.mark.parametrize("name", ["hertz", "kelvin_voigt"])
@pytest.mark.parametrize(
    ("stiffness", "exponent"), [(1.0, 1.0), (1.0, 3.0), (1e15, 1.0), (1e15, 3.0)]
)
@pytest.mark.parametrize(("mass", "period"), [(1e-4, 1e9), (1e-4, 1.0), (1e3, 1e-9)])
def test_the_largest_samples_do_not_break_the_run(name, stiffness, exponent, mass, period):
    damping = {"damping": 1e9} if name == "kelvin_voigt" else {}
    hard = law(name, stiffness=stiffness, exponent=exponent, **damping)
    load = np.array([LARGEST_LOAD, -LARGEST_LOAD, LARGEST_LOAD, -LARGEST_LOAD, 0.0, LARGEST_LOAD])
    angle = np.array(
        [LARGEST_ANGLE, -LARGEST_ANGLE, LARGEST_ANGLE, 0.0, -LARGEST_ANGLE, LARGEST_ANGLE]
    )
    knee = model(hard, 1e-12, ellipse(24), mass=mass, budget=1000)
    series = fast(knee).run(np.arange(6) * period, angle, load)
    for field in FIELDS:
        assert np.isfinite(series[field]).all(), field
    assert series.tobytes() == knee.run(np.arange(6) * period, angle, load).tobytes()
