"""What is said of the stamps, and of being late."""

from __future__ import annotations

import pytest
from diagnostic_msgs.msg import DiagnosticStatus

from knee_contact_ros.model.types import Status
from knee_contact_ros.node.diagnostics import InputMeter, LagMeter, PairingMeter, TickMeter, diagnostic_status
from knee_contact_ros.parameters.schema import Pairing
from knee_contact_ros.streams.pairing import AngleSample, LoadSample, Synchroniser

MS = 1_000_000


def feed(synchroniser: Synchroniser, stamps: range, ahead: int = 0) -> None:
    """Angles at stamps [ms], and forces with stamps that are so much later [ms]."""
    for stamp in stamps:
        synchroniser.push_angle(AngleSample(stamp * MS, 0.1, None))  # type: ignore[arg-type]
        synchroniser.push_load(LoadSample((stamp + ahead) * MS, 1.0, 0.0, ""))


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


class Time:
    """A clock that goes where it is set."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.now = 100.0
        monkeypatch.setattr("knee_contact_ros.node.diagnostics.time.monotonic", lambda: self.now)
        monkeypatch.setattr("knee_contact_ros.node.diagnostics.time.time", lambda: 1000.0 + self.now)

    def receive(self, meter: InputMeter, number: int, period: float, age: float = 0.0) -> None:
        """Messages that come every period [s], with stamps so old [s]."""
        for _ in range(number):
            self.now += period
            meter.arrivals.append((self.now, 1000.0 + self.now, round(1e9 * (1000.0 + self.now - age))))
        meter.take()


def test_an_input_is_judged_by_what_it_was_asked_for(monkeypatch: pytest.MonkeyPatch) -> None:
    """Not received, rate low, silent, timeout: levels as other topic monitors have them."""
    clock = Time(monkeypatch)
    meter = InputMeter(warn_rate=90.0, error_rate=40.0, max_gap=0.1, timeout=1.0, last=clock.now)
    meter.begin()

    def judged() -> tuple[bytes, str]:
        _, (text, level) = meter.report()
        return level, text

    clock.now += 0.5
    assert judged() == (DiagnosticStatus.STALE, "nothing received yet")
    clock.receive(meter, 10, 0.05)  # the first second tells of no rate
    assert judged() == (DiagnosticStatus.OK, "")
    for period, level, text in (
        (0.01, DiagnosticStatus.OK, ""),
        (0.0125, DiagnosticStatus.WARN, "rate low: 80.0 Hz, below 90 Hz"),
        (0.05, DiagnosticStatus.ERROR, "rate low: 20.0 Hz, below 40 Hz"),
    ):
        clock.receive(meter, 80, period)
        assert judged() == (level, text)
    clock.now += 0.5
    assert judged() == (DiagnosticStatus.WARN, "silent for 0.5 s")
    clock.now += 0.6
    assert judged() == (DiagnosticStatus.STALE, "timeout: silent for 1.1 s")


def test_periods_and_ages_are_told_as_topic_statistics_are(monkeypatch: pytest.MonkeyPatch) -> None:
    clock = Time(monkeypatch)
    meter = InputMeter(last=clock.now)
    clock.receive(meter, 3, 0.010, age=0.004)
    clock.receive(meter, 1, 0.030, age=0.008)
    meter.arrivals.append((clock.now, 0.0, None))
    meter.take()
    values, _ = meter.report()
    told = {name: value for name, value in values.items() if " mean " in name or " max " in name or " std " in name}
    assert told == {
        "period mean [ms]": "12.000", "period max [ms]": "30.000", "period std [ms]": "9.798",
        "message age mean [ms]": "5.000", "message age max [ms]": "8.000", "message age std [ms]": "1.732",
    }  # fmt: skip


def test_messages_before_a_pause_of_the_node_stay_in_the_total(monkeypatch: pytest.MonkeyPatch) -> None:
    """They may have come after the last report; the silence of the pause is no period."""
    clock = Time(monkeypatch)
    meter = InputMeter(last=clock.now)
    clock.receive(meter, 3, 0.01)
    meter.arrivals.append((clock.now, 1000.0 + clock.now, None))
    clock.now += 5.0
    meter.begin()
    clock.receive(meter, 2, 0.01)
    values, _ = meter.report()
    assert (values["received"], values["longest pause [ms]"]) == ("6", "10.0")


@pytest.mark.parametrize("bit", [bit for bit in Status if bit])
def test_usable_is_said_of_the_newest_answer(bit: Status, monkeypatch: pytest.MonkeyPatch) -> None:
    clock = Time(monkeypatch)
    meter = TickMeter()
    values, problem = meter.usability(1.0)
    assert (values["usable"], values["because"], problem.level) == ("false", "no answer yet", DiagnosticStatus.STALE)
    meter.answers.append((0, bit, 1e-4, False, clock.now))
    meter.take()
    values, problem = meter.usability(1.0)
    harmless = bit in (Status.INPUT_REJECTED, Status.DOUBTFUL_LOAD)
    assert values["usable"] == ("true" if harmless else "false")
    assert values["because"] == ("" if harmless else bit.name)
    assert problem.level == (DiagnosticStatus.OK if harmless else DiagnosticStatus.WARN)
    meter.answers.append((0, Status.OK, 1e-4, False, clock.now))
    meter.take()
    assert meter.usability(1.0)[0]["usable"] == "true"
    clock.now += 1.1
    values, problem = meter.usability(1.0)
    assert (values["usable"], values["because"], problem.level) == (
        "false",
        "no answer for 1.1 s",
        DiagnosticStatus.STALE,
    )


def test_ticks_longer_than_forces_are_apart_are_overruns() -> None:
    meter = TickMeter()
    for duration in (1e-4, 2e-3, 3e-3):
        meter.answers.append((0, Status.OK, duration, False, 0.0))
        meter.take()
    assert meter.values(2.5e-3)["overruns"] == "1"
    meter.answers.append((0, Status.OK, 3e-3, False, 0.0))
    meter.take()
    assert meter.values(2.5e-3)["overruns"] == "2"
