"""The control law of the example: bounds, rates, giving way, returning, doubt."""

import math
from dataclasses import fields, replace
from typing import NamedTuple

import pytest
from hypothesis import given
from hypothesis import strategies as st
from ruamel.yaml import YAML

from examples.assist_as_needed import UNTRUSTED, AssistLaw, Settings
from knee_contact_ros.model.types import UNUSABLE, Status
from knee_contact_ros.system.files import share_folder

SETTINGS = Settings()
LOW, INSIDE, HIGH = 500.0, 1300.0, 1401.0
"""[N] contact forces below the band, inside it and above the limit"""
ROUNDING = 1e-12


class Event(NamedTuple):
    """Time [s] since the one before, and the answer heard; None: only a command is due."""

    elapsed: float
    answer: tuple[float, int, float] | None


answers = st.tuples(
    st.one_of(st.sampled_from([LOW, INSIDE, HIGH, math.nan, math.inf]), st.floats(0.0, 3000.0)),
    st.sampled_from([0, 0, 0, *range(32)]),
    st.sampled_from([0.0, 0.0, 1e-6, 1e-5, 1.1e-5, 1.0, math.nan]),
)
events = st.lists(
    st.builds(Event, st.floats(0.0, 0.05) | st.floats(0.0, 3.0), answers | st.none()),
    min_size=1,
    max_size=60,
)
settings = st.builds(
    Settings,
    nominal_torque=st.floats(0.1, 100.0),
    fall_rate=st.floats(1.0, 1000.0),
    rise_rate=st.floats(1.0, 1000.0),
    timeout=st.floats(0.01, 0.5),
)


@given(settings, events)
def test_whatever_comes_bounds_rates_and_doubt_hold(settings, events):
    law, now, heard = AssistLaw(settings), 0.0, -math.inf
    answer, before = (math.nan, 0, 0.0), law.command(0.0)
    assert before == 0.0
    for event in events:
        now += event.elapsed
        if event.answer is not None:
            heard, answer = now, event.answer
            law.hear(now, *answer)
        torque = law.command(now)
        assert 0.0 <= torque <= settings.nominal_torque
        assert (
            torque - before <= settings.rise_rate * min(event.elapsed, settings.timeout) + ROUNDING
        )
        assert before - torque <= settings.fall_rate * event.elapsed + ROUNDING
        force, status, error = answer
        trusted = (
            now - heard <= settings.timeout
            and not status & ~Status.INPUT_REJECTED
            and error <= settings.largest_error
            and math.isfinite(force)
        )
        if not trusted or force > settings.force_limit:
            # As far as the rate allows, and no less
            assert torque == pytest.approx(
                max(before - settings.fall_rate * event.elapsed, 0.0), abs=ROUNDING
            )
        elif force >= settings.force_limit - settings.release_band:
            assert torque >= before
        else:
            assert (
                torque > before
                or event.elapsed == 0.0
                or torque in (before, settings.nominal_torque)
            )
        assert bool(law.doubt) is not trusted
        before = torque


def torques(law, start, *forces):
    """Commands to answers that come every 5 ms."""
    commands = []
    for number, force in enumerate(forces):
        law.hear(start + 0.005 * number, force, 0, 0.0)
        commands.append(law.command(start + 0.005 * number))
    return commands


def law_at_nominal():
    """A law that has heard small forces for 1 s, until 1.0."""
    law = AssistLaw(SETTINGS)
    assert torques(law, 0.0, *[LOW] * 201)[-1] == SETTINGS.nominal_torque
    return law


def test_inside_the_band_the_torque_stays_until_the_force_is_below_it():
    law = law_at_nominal()
    assert torques(law, 1.005, INSIDE, INSIDE) == [10.0, 10.0]
    # 200 N m/s x 5 ms down, 20 N m/s x 5 ms on the way back
    assert torques(law, 1.015, HIGH, INSIDE, INSIDE, LOW, INSIDE, LOW) == pytest.approx(
        [9.0, 9.0, 9.0, 9.1, 9.2, 9.3], abs=ROUNDING
    )


def test_a_stream_that_stops_takes_the_torque_to_zero_and_back_slowly():
    law = law_at_nominal()
    assert law.command(1.09) == 10.0
    assert law.command(1.11) == pytest.approx(6.0, abs=ROUNDING)  # 200 N m/s x 20 ms
    assert law.doubt == "no answer for 0.1 s"
    assert law.command(2.0) == 0.0
    assert torques(law, 9.0, LOW, LOW) == pytest.approx(
        [2.0, 2.1], abs=ROUNDING
    )  # 7 s late: a rise of 0.1 s at most


def test_each_flag_of_an_answer_is_told_as_the_doubt():
    law = law_at_nominal()
    for number, bit in enumerate(bit for bit in Status if bit & UNUSABLE):
        law.hear(1.0 + number, LOW, bit | Status.INPUT_REJECTED, 0.0)
        law.command(1.0 + number)
        assert (law.doubt, law.usable) == (UNTRUSTED[int(bit)], False)


def test_answers_of_another_node_without_a_flag_drive_no_torque():
    law = law_at_nominal()
    for number in range(200):
        law.hear(1.005 + 0.005 * number, LOW, 0 if number % 20 else Status.SEVERAL_PUBLISHERS, 0.0)
        law.command(1.005 + 0.005 * number)
    assert law.torque == 0.0
    assert torques(law, 3.0, LOW)[0] > 0.0


def test_stopped_it_goes_to_zero_whatever_comes():
    law = law_at_nominal()
    law.stop()
    assert torques(law, 1.005, *[LOW] * 10)[-1] == pytest.approx(0.0, abs=ROUNDING)
    assert torques(law, 1.055, *[LOW] * 10) == [0.0] * 10


@pytest.mark.parametrize("name", [field.name for field in fields(Settings)])
@pytest.mark.parametrize("value", [0.0, -1.0, math.nan, math.inf, 5])
def test_settings_are_numbers_above_zero(name, value):
    with pytest.raises(
        ValueError, match=f"^{name}: {value} is not allowed; it should be a number > 0$"
    ):
        replace(SETTINGS, **{name: value})
    with pytest.raises(ValueError, match="it should be below force_limit"):
        Settings(release_band=1400.0)


def test_the_shipped_parameters_are_the_defaults():
    path = share_folder() / "examples" / "assist_as_needed.yaml"
    (section,) = YAML(typ="safe", pure=True).load(path.read_text(encoding="utf-8")).values()
    assert Settings(**section["ros__parameters"]) == SETTINGS
