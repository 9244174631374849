"""What is said of the stamps, and of being late."""

from __future__ import annotations

import pytest
from diagnostic_msgs.msg import DiagnosticStatus

from knee_contact_ros.node.diagnostics import LagMeter, PairingMeter, diagnostic_status
from knee_contact_ros.parameters.schema import Pairing
from knee_contact_ros.pipeline.samples import AngleSample, LoadSample
from knee_contact_ros.pipeline.synchronise import Synchroniser

MS = 1_000_000


def feed(synchroniser: Synchroniser, stamps: range, ahead: int = 0) -> None:
    """Angles at stamps [ms], and forces with stamps that are so much later [ms]."""
    for stamp in stamps:
        synchroniser.push_angle(AngleSample(stamp * MS, 0.1, None))  # type: ignore[arg-type]
        synchroniser.push_load(LoadSample((stamp + ahead) * MS, 1.0, "", None))  # type: ignore[arg-type]


def test_all_is_well() -> None:
    synchroniser, meter = Synchroniser(Pairing()), PairingMeter(0.1)
    feed(synchroniser, range(0, 100, 5))
    values, problem, lost = meter.report(synchroniser)
    assert (problem, lost) == ("", False)
    assert values["force ahead of angle [s]"] == "0.000"


def test_what_has_happened_to_the_stamps_is_said_once() -> None:
    synchroniser, meter = Synchroniser(Pairing()), PairingMeter(0.1)
    feed(synchroniser, range(1000, 1100, 5))
    synchroniser.push_angle(AngleSample(1300 * MS, 0.1, None))  # type: ignore[arg-type]
    feed(synchroniser, range(1100, 1200, 5))
    assert meter.report(synchroniser)[1] == "1 stamps fit neither the sample before nor the other topic"
    assert meter.report(synchroniser)[1] == ""
    feed(synchroniser, range(100, 200, 5))
    problem = meter.report(synchroniser)[1]
    assert problem == "stamps of joint_states have jumped; stamps of joint_reaction_force have jumped"
    assert meter.report(synchroniser)[1] == ""


def test_clocks_that_disagree_are_said_as_long_as_they_do() -> None:
    synchroniser, meter = Synchroniser(Pairing()), PairingMeter(0.1)
    feed(synchroniser, range(0, 500, 5), ahead=150)
    for _ in range(2):
        problem = meter.report(synchroniser)[1]
        assert problem == "stamps of joint_states lie 0.150 s behind those of joint_reaction_force"
    feed(synchroniser, range(2000, 2500, 5), ahead=-150)
    assert "stamps of joint_reaction_force lie 0.150 s behind those of joint_states" in meter.report(synchroniser)[1]


def test_a_queue_warns_from_a_quarter_on_and_is_an_error_when_it_drops() -> None:
    synchroniser, meter = Synchroniser(Pairing(queue=100)), PairingMeter(0.1)
    for stamp in range(30):
        synchroniser.push_angle(AngleSample(stamp * MS, 0.1, None))  # type: ignore[arg-type]
    values, problem, lost = meter.report(synchroniser)
    assert (problem, lost) == ("30 % of pairing.queue wait for the other topic", False)
    assert diagnostic_status("a", values, problem, lost).level == DiagnosticStatus.WARN
    for stamp in range(30, 130):
        synchroniser.push_angle(AngleSample(stamp * MS, 0.1, None))  # type: ignore[arg-type]
    values, problem, lost = meter.report(synchroniser)
    assert problem.startswith("30 angles are not recorded: more than pairing.queue came without a force")
    assert values["angles not recorded"] == "30"
    assert diagnostic_status("a", values, problem, lost).level == DiagnosticStatus.ERROR
    assert not meter.report(synchroniser)[2]


def test_a_timer_that_comes_late_shows_by_how_much(monkeypatch: pytest.MonkeyPatch) -> None:
    meter = LagMeter(0.125, _last=5.0)
    for time, late in ((5.375, 0.25), (5.5, 0.0), (6.25, 0.625), (6.375, 0.0), (6.4375, 0.0)):
        monkeypatch.setattr("time.monotonic", lambda time=time: time)
        meter.count()
        assert meter.now == late
    assert (meter.report(), meter.report()) == (0.625, 0.0)
