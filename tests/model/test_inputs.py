"""Implausible angles and loads are reported with values and the likely cause; those of 2000 gaits are not."""

import warnings

import numpy as np
import pytest

import knee_contact_ros
from knee_contact_ros.model.inputs import AxisCheck, InputCheck
from knee_contact_ros.model.types import FIRST_DATE, Status
from studies.validation.data import level_walks, walks
from studies.validation.movements import CYCLES, made
from tests.streams.test_gait_events import LEFT, RIGHT, walking

WEIGHT = 700.0
Columns = tuple[np.ndarray, np.ndarray, np.ndarray]


def gait(generator=None):
    """Times [s], flexion [rad] and load [N] of four strides; of another person and speed with a generator."""
    u = (
        (lambda low, high: float(generator.uniform(low, high)))
        if generator
        else (lambda low, high: 0.5 * (low + high))
    )
    step, stride, shift = u(0.002, 0.018), u(0.8, 1.6), u(0.0, 1.0)
    time = np.arange(0.0, 4.0 * stride, step)
    p = (time / stride + shift) % 1.0

    def bump(at, width):
        return np.exp(-(((p - at) / width) ** 2))

    angle = u(-8.0, 20.0) + u(2.0, 22.0) * bump(0.15, 0.08) + u(25.0, 70.0) * bump(0.72, 0.11)
    load = WEIGHT * (
        u(-0.1, 0.3) + u(1.5, 4.0) * bump(0.16, 0.07) + u(1.5, 4.0) * bump(0.48, 0.09)
    )
    return time, np.radians(angle), load


def moved(time, load, late):
    """A load that is late by a time [s], or early; its end goes over into its beginning."""
    whole = time[-1] - time[0] + np.median(np.diff(time))
    return np.interp((time - time[0] - late) % whole, [*(time - time[0]), whole], [*load, load[0]])


def sentences_about(time, angle, load, weight=WEIGHT):
    """Return the sentences about a run, the same of all at once and in parts."""
    whole, parts = InputCheck(weight), InputCheck(weight)
    stamps = np.rint(1e9 * time).astype(np.int64)
    whole.add_samples(stamps, angle, load)
    for part in np.array_split(np.arange(len(time)), 7):
        parts.add_samples(stamps[part], angle[part], load[part])
    assert whole.sentences == parts.sentences
    return whole.sentences


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (
            lambda t, q, load: (t, 6.0 * q, load),
            "36.0 to 320.7 deg, and a knee has -30 to 170 (92 of 481 ticks are beyond): are 0.629 to 5.5",
        ),
        (
            lambda t, q, load: (t, q + 5.0, load),
            "does it have an offset (knee.flexion_offset, in rad), or is it in degrees",
        ),
        (
            lambda t, q, load: (t[:90], -q[:90], load[:90]),
            "): is its sign the other one (knee.flexion_sign -1), does",
        ),
        (
            lambda t, q, load: (t, -q, load),
            "deg, which is extension: is its sign the other one (knee.flexion_sign -1)",
        ),
        (
            lambda t, q, load: (t, np.pi - q, load),
            "is it the included angle, 180 deg - flexion (knee.flexion_sign -1,",
        ),
        (lambda t, q, load: (t, q, 0.0 * load), "the load was 0 throughout: does another axis"),
        (lambda t, q, load: (t, q, -load), "the load was negative throughout (-1994 to -70 N)"),
        (lambda t, q, load: (t, q, 120.0 - load), "the load was negative for the most part (-"),
        (
            lambda t, q, load: (t, q, load / 1e3),
            "N throughout: is it in kN or body weights instead of N?",
        ),
        (
            lambda t, q, load: (t, q, load / WEIGHT),
            "N throughout: is it in kN or body weights instead of N?",
        ),
        (
            lambda t, q, load: (t, q, 0.5 * load / 7.0),
            "N at most: is it in percent of body weight instead of N?",
        ),
        (
            lambda t, q, load: (t, q, np.where(t == t[50], 41e3, load)),
            "the load reaches 41000 N (58.6 body weights, beyond 7000 N in 1 of ",
        ),
        (
            lambda t, q, load: (1e3 * t, q, load),
            "s apart: are their times in milliseconds instead of seconds?",
        ),
        (
            lambda t, q, load: (t, q, moved(t, load, 0.4)),
            "a step is the other way round; are angle and load of the same times",
        ),
        (
            lambda t, q, load: (t, q, moved(t, load, -0.4)),
            "a step is the other way round; are angle and load of the same times",
        ),
        (lambda t, q, load: (np.where(t > t[200], t + 2.0, t), q, load), "a hole of 2"),
        (
            lambda t, q, load: (t[::40], q[::40], load[::40]),
            "s apart, and the load changes by",
        ),
        (
            lambda t, q, load: (t / 7.0, q, load),
            "rad/s (at ",
        ),
    ],
)
def test_an_implausible_input_is_reported_in_one_sentence(change, words):
    sentences = sentences_about(*change(*gait()))
    assert len(sentences) == 1
    assert words in sentences[0]


def test_two_thousand_gaits_are_not_doubted():
    for seed in range(2000):
        time, angle, load = gait(np.random.default_rng(seed))
        assert sentences_about(time, angle, load) == [], seed
        assert sentences_about(time, angle, 0.5 * load, None) == [], seed
        assert sentences_about(time, angle, 0.25 * load) == [], (
            seed
        )  # half of it borne by an exoskeleton


def told_times(time, angle, load, weight, share):
    """Whether times of angle and load are doubted, as they are, with a load that is 0.4 s late, and early."""
    found = []
    for late in (0.0, 0.4, -0.4):
        seen = InputCheck(weight, share=share)
        seen.add_samples(np.rint(1e9 * time).astype(np.int64), angle, moved(time, load, late))
        found.append(bool(seen.about_pairing))
    return found


@pytest.mark.parametrize("share", [0.5, 1.0])
@pytest.mark.parametrize("samples", [RIGHT, LEFT, walking(200.0, 8.0)])
def test_a_load_of_another_time_is_doubted_in_the_shipped_gait(samples, share):
    stamps, angle, load = samples
    time = (stamps - stamps[0]) / 1e9
    assert told_times(time, angle, 2.0 * share * load, 737.0, share) == [False, True, True]


def test_a_load_of_another_time_is_doubted_in_measured_gaits(reference_data):
    measured = level_walks(walks(reference_data))
    if not measured:
        pytest.skip("the measurements of the instrumented knees are not on this machine")
    for walk in measured:
        known = np.isfinite(walk.total)
        time, angle, load = (each[known] for each in (walk.time, walk.flexion, walk.total))
        told = told_times(time, angle, load, walk.person.body_weight, 1.0)
        assert told == [False, True, True], walk.name


def test_movements_of_other_kinds_and_mixtures_of_them_are_not_doubted():
    """A knee bears its load bent on stairs, chairs and in squats, and at 44 degrees in running."""
    random = np.random.default_rng(5)
    names = list(CYCLES)
    bouts = [[(name, 20.0)] for name in names for _ in range(20)] + [
        [(names[which], random.uniform(5.0, 25.0)) for which in random.integers(0, len(names), 6)]
        for _ in range(100)
    ]
    for several in bouts:
        parts = [made(name, seconds, random) for name, seconds in several]
        angle, force = (np.concatenate(column) for column in zip(*parts, strict=True))
        in_air = 0.06 + 0.02 * np.sin(np.arange(len(angle)))  # the shank's weight, as on a stand
        for load in (force, force * (1.0 + 1.2 * angle / np.radians(90.0)), in_air):
            seen = InputCheck(WEIGHT, share=0.5)
            stamps = 10_000_000 * np.arange(len(angle))
            seen.add_samples(stamps, angle, WEIGHT * load)
            assert not seen.about_pairing, several


def test_a_net_joint_force_is_no_contact_load():
    """It is the ground's force and the shank's weight; the contact force of the same knee has muscles, too."""
    time, angle, load = gait()
    stamps = np.rint(1e9 * time).astype(np.int64)
    net = 1.1 * WEIGHT * load / load.max()
    for share, loads, doubted in (
        (1.0, net, True),
        (0.5, 0.5 * net, True),
        (1.0, load, False),
        (0.5, 0.5 * load, False),
        (None, net, False),
        (1.0, np.maximum(net, 0.9 * WEIGHT), False),
    ):
        seen = InputCheck(WEIGHT, share=share)
        seen.add_samples(stamps, angle, loads)
        assert [("no muscle forces" in each) for each in seen.sentences] == [True] * doubted
    slow = InputCheck(WEIGHT, share=0.5)
    slow.add_samples(stamps, angle, 5.5 * WEIGHT * load / load.max())
    assert "beyond 3500 N" in slow.about_load  # 11 body weights in the whole knee


def axes(forces, turned_by=""):
    """Return the sentence about forces [N], the same of all at once and one by one."""
    whole, each = AxisCheck(turned_by=turned_by), AxisCheck(turned_by=turned_by)
    whole.add_forces(forces)
    for force in forces.tolist():
        each.add_force(*force)
    assert whole.sentence == each.sentence
    return whole.sentence


def test_a_load_along_another_axis_is_reported():
    _, _, load = gait()
    right = np.column_stack([0.2 * load, -load, 0.1 * load])
    assert axes(right) == ""
    assert axes(0.0 * right) == ""
    assert axes(np.where(np.arange(3) == 2, np.nan, right)) == ""  # an axis that is not measured
    mean = f"{np.abs(load).mean():.0f}"
    assert axes(right[:, [0, 2, 1]]).startswith(
        f"force.z carries {mean} N on average, and force.y "
    )
    upright = axes(right[:, [0, 2, 1]])
    assert "is z up? Where it is < 0 in compression, set load.rotation to -90 0 0 deg" in upright
    assert upright.endswith("it points down: set 90 0 0 deg, or name wrench.force.z")
    assert axes(right[:, [1, 0, 2]]).startswith(f"force.x carries {mean} N")
    assert axes(right[:, [0, 2, 1]], "frame.tibia 'tibia_isb'").endswith(
        "is z up? Is frame.tibia 'tibia_isb' right?"
    )


def test_a_run_warns_once_and_its_flight_is_implausible():
    model, (time, angle, load) = knee_contact_ros.load_model(compiled=False), gait()
    with pytest.warns(UserWarning, match="the load was negative throughout") as caught:
        answers = model.run(time, angle, -load)
    assert len(caught) == 1
    assert caught[0].filename == __file__
    assert ((answers.status & Status.IMPLAUSIBLE) != 0).sum() > 0.95 * len(answers)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        answers = model.run(time, angle, load)
    assert not answers.status.any()
    with pytest.raises(ValueError, match=r"is it in degrees\?$"):
        model.run(time, np.degrees(angle), load)


HOLE = np.r_[0:900, 1299:1600]
"""Samples at 200 Hz, of which two seconds in the middle are missing"""


@pytest.mark.parametrize(
    ("rate", "kept", "words"),
    [
        (1.0, slice(None), "the samples are 1 s apart, and the load changes by"),
        (200.0, HOLE, "there is a hole of 2 s between two samples"),
        (200.0, slice(None), ""),
    ],
)
def test_a_run_warns_of_a_gait_at_1_hz_and_of_a_hole(rate, kept, words):
    stamps, angle, load = (column[kept] for column in walking(rate, 8.0 * max(1.0, 5.0 / rate)))
    model = knee_contact_ros.load_model("healthy")
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        model.run((stamps - stamps[0]) / 1e9, angle, load)
    assert [words in str(each.message) for each in caught] == ([True] if words else [])
    assert all(each.filename == __file__ for each in caught)


def test_the_landing_of_a_flight_is_implausible_until_it_has_settled():
    model = knee_contact_ros.load_model(compiled=False)
    time = np.arange(0.0, 1.0, 0.002)
    load = np.where((time > 0.2) & (time < 0.3), -100.0, 700.0)
    answers = model.run(time, 0.2 + 0.0 * time, load)
    assert answers.gap.max() > 0.01
    flagged = (answers.status & Status.IMPLAUSIBLE) != 0
    assert flagged[answers.contact_force.argmax()]
    assert not flagged[time <= 0.2].any()
    assert not flagged[-1]
    small = model.run(
        time, 0.2 + 0.0 * time, np.where((time > 0.2) & (time < 0.21), -100.0, 700.0)
    )
    assert 0.0 < small.gap.max() < 0.01
    assert not (small.status & Status.IMPLAUSIBLE).any()


@pytest.mark.parametrize(
    ("begin", "words"), [(0, "at 1.49 s)"), (FIRST_DATE, "at 1.49 s from the")]
)
def test_a_jump_of_the_angle_is_told_with_its_time_since_the_start_of_dates(begin, words):
    stamps, angle = begin + np.arange(300) * 10_000_000, np.zeros(300)
    angle[149:] = 2.0
    check = InputCheck()
    check.add_samples(stamps, angle, np.full(300, 800.0))
    assert words in check.about_turning
