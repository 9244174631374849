"""What is said of the inputs, of the stamps, of the answers and of being late."""

from types import SimpleNamespace
from typing import Any

import pytest

from knee_contact_ros.model.types import Status
from knee_contact_ros.node.diagnostics import Health
from knee_contact_ros.node.inputs import InputMeter
from knee_contact_ros.node.problems import ERROR, OK, STALE, WARN
from knee_contact_ros.parameters.files import load_parameters
from knee_contact_ros.streams.contact_pipeline import ContactPipeline
from knee_contact_ros.streams.timeline import AngleSample, LoadSample

MS = 1_000_000


class Time:
    """A clock that goes where it is set, and a health that reads it."""

    def __init__(self, monkeypatch):
        self.now = 100.0
        self.age = 0.0
        """Age [s] of the stamps that come, by the system's clock"""
        monkeypatch.setattr("time.monotonic", lambda: self.now)
        monkeypatch.setattr("time.time", lambda: self.age)
        self.logged: list[str] = []
        stream = SimpleNamespace(meter=SimpleNamespace(longest_pause=0.0, last=self.now))
        self.inputs: Any = (stream, stream)
        self.of({})

    def of(self, parameters):
        """Health of a node with these parameters."""
        read, log = load_parameters(parameters), SimpleNamespace(warning=self.logged.append)
        self.paired = ContactPipeline(read, compiled=False)
        node: Any = SimpleNamespace(
            get_fully_qualified_name=lambda: "/knee", get_logger=lambda: log
        )
        self.health = Health(node, read, self.paired)
        return self.health

    def feed(self, stamps, ahead=0):
        """Angles at stamps [ms], and forces with stamps that are so much later [ms]."""
        for stamp in stamps:
            self.push_angle(stamp)
            load = LoadSample((stamp + ahead) * MS, 1.0, 0.0, "")
            list(self.paired.synchroniser.push_load(load))

    def push_angle(self, stamp):
        """An angle at a stamp [ms]."""
        list(self.paired.synchroniser.push_angle(AngleSample(stamp * MS, 0.1)))

    def receive(self, meter, number, period, age=0.0):
        """Messages that come every period [s], with stamps so old [s]."""
        for _ in range(number):
            self.now += period
            self.age = age
            meter.count_message(0)

    def answer(self, status=0, duration=1e-4):
        """An answer that has come now."""
        self.health.counts.count_answer(0, status, duration, 0.0, self.health.parameters.deadline)


@pytest.fixture
def clock(monkeypatch):
    return Time(monkeypatch)


def test_what_has_happened_to_the_stamps_is_said_once(clock):
    health = clock.health
    clock.feed(range(1000, 1100, 5))
    _, values, problem = health.pairing_entry(clock.inputs)
    assert (values["force ahead of angle [s]"], problem) == ("0.000", (OK, ""))
    clock.push_angle(1300)
    clock.feed(range(1100, 1200, 5))
    assert health.pairing_entry(clock.inputs)[2] == (
        WARN,
        "1 stamps fit neither the sample before nor the other topic",
    )
    assert health.pairing_entry(clock.inputs)[2] == (OK, "")
    clock.feed(range(100, 200, 5))
    jumped = "; ".join(
        f"stamps of {topic} have jumped by -1.09 s"
        for topic in ("joint_states", "joint_reaction_force")
    )
    assert health.pairing_entry(clock.inputs)[2] == (WARN, jumped)
    assert health.pairing_entry(clock.inputs)[2] == (OK, "")
    clock.now += 5.0
    clock.feed(range(0, 50, 5))
    health.pairing_entry(clock.inputs)
    words = [said.partition(";")[0].split()[-1] for said in clock.logged]
    assert words == ["topic", "s"]  # 5 s lie between


def test_a_pause_is_no_jump_of_a_clock(clock):
    health = clock.health
    clock.feed(range(0, 100, 5))
    clock.inputs[0].meter.longest_pause = 0.34
    clock.feed(range(425, 500, 5))
    told = "no samples on joint_states for 0.33 s; no samples on joint_reaction_force for 0.33 s"
    assert health.pairing_entry(clock.inputs)[2] == (WARN, told)


def test_angles_slower_than_the_largest_gap_are_said(clock):
    for stamp in range(0, 2000, 200):
        clock.push_angle(stamp)
        clock.push_angle(stamp)
    (_, _, (_, told)) = clock.health.pairing_entry(clock.inputs)
    assert "joint_states comes every 0.20 s, and pairing.max_gap is 0.1 s: every answer" in told


def test_sentences_name_the_users_topics(clock):
    health = clock.of({"knee.source": "exo/encoder", "load.source": "exo/ft"})
    clock.feed(range(0, 500, 5), ahead=150)
    (_, values, (_, told)) = health.pairing_entry(clock.inputs)
    assert "stamps of exo/encoder lie 0.150 s behind those of exo/ft: synchronise" in told
    assert "jumps of exo/ft" in values


def test_refused_angles_are_no_clock_that_differs(clock):
    """Their last stamp lies back; a user with degrees was told to synchronise the clocks."""
    clock.feed(range(0, 500, 5))
    for stamp in range(500, 700, 5):
        clock.paired.synchroniser.refused.count_refused("out_of_range")
        list(clock.paired.synchroniser.push_load(LoadSample(stamp * MS, 1.0, 0.0, "")))
    assert clock.paired.synchroniser.lead == 0.2
    assert "synchronise" not in clock.health.pairing_entry(clock.inputs)[2][1]


def test_a_silent_topic_is_no_clock_that_differs(clock):
    clock.feed(range(0, 500, 5))
    for stamp in range(500, 8000, 5):
        clock.push_angle(stamp)
    clock.inputs[1].meter.last -= 7.5
    assert "synchronise" not in clock.health.pairing_entry(clock.inputs)[2][1]


def test_a_lag_counts_only_while_answers_come_and_after_the_start(clock):
    health = clock.health
    health.counts.start_timer()
    for wait, busy, told in ((1.0, True, False), (3.0, False, False), (1.0, True, True)):
        clock.now += wait
        health.counts.note_timer(0.025)
        if busy:
            clock.answer()
        assert ("behind" in health.ticks_entry()[2][1]) == told


@pytest.mark.parametrize(
    ("ahead", "first", "second"), [(150, "states", "force"), (-150, "force", "states")]
)
def test_clocks_that_disagree_are_said_as_long_as_they_do(clock, ahead, first, second):
    clock.feed(range(0, 500, 5), ahead=ahead)
    for _ in range(2):
        _, _, (_, problem) = clock.health.pairing_entry(clock.inputs)
        assert f"stamps of joint_{first}" in problem.replace("reaction_", "")
        assert f"lie 0.150 s behind those of joint_{second}" in problem.replace("reaction_", "")


def test_a_queue_warns_from_a_quarter_on_and_is_an_error_when_it_drops(clock):
    health = clock.of({"pairing.queue": 100})
    lost, wait = (
        "30 angles are not recorded: more of them than pairing.queue came without a force; ",
        "of pairing.queue",
    )
    for stamps, found in (
        (range(30), (WARN, f"30 % {wait} wait for the other topic")),
        (range(30, 130), (ERROR, f"{lost}100 % {wait} wait for the other topic")),
        (range(0), (WARN, f"100 % {wait} wait for the other topic")),
    ):
        for stamp in stamps:
            clock.push_angle(stamp)
        _, values, problem = health.pairing_entry(clock.inputs)
        assert problem == found
    assert values["angles not recorded"] == "30"


def test_a_late_timer_shows_its_lag(clock):
    health = clock.of({"pairing.wait": 0.5, "deadline": 0.2})  # looks every 0.125 s
    late, waits = [], [0.0, 0.375, 0.125, 0.75, 0.125, 0.0625]
    for later in waits:
        clock.now += later
        health.counts.note_timer(0.125)
        clock.answer()
        late.append(health.increase("late", int(health.ticks_entry()[1]["missed deadlines"])))
    assert late == [0, 1, 0, 1, 0, 0]
    assert clock.logged == ["the node is behind by up to 250 ms"]


def test_an_input_is_judged_by_what_it_was_asked_for(clock):
    """Not received, rate low, silent, timeout: levels as other topic monitors have them."""
    meter = InputMeter(warn_rate=90.0, error_rate=40.0, max_gap=0.1, timeout=1.0)
    clock.now += 0.5
    assert meter.report_rate()[1] == (STALE, "nothing received yet")
    clock.receive(meter, 10, 0.05)  # the first second tells of no rate
    assert meter.report_rate()[1] == (OK, "")
    for period, problem in (
        (0.01, (OK, "")),
        (0.0125, (WARN, "rate low: 80.0 Hz, below 90 Hz")),
        (0.05, (ERROR, "rate low: 20.0 Hz, below 40 Hz")),
    ):
        clock.receive(meter, 80, period)
        assert meter.report_rate()[1] == problem
    for later, problem in (
        (0.5, (WARN, "silent for 0.5 s")),
        (0.6, (STALE, "timeout: silent for 1.1 s")),
    ):
        clock.now += later
        assert meter.report_rate()[1] == problem


def test_messages_and_ages_are_counted_without_pauses_of_the_node(clock):
    meter = InputMeter()
    clock.receive(meter, 3, 0.01)
    meter.count_message(None)
    clock.now += 5.0
    meter.restart()
    clock.receive(meter, 2, 0.01, age=0.004)
    clock.receive(meter, 1, 0.03, age=0.008)
    values, _ = meter.report_rate()
    assert (values["received"], values["longest pause [ms]"]) == ("7", "30.0")
    assert (values["message age mean [ms]"], values["message age max [ms]"]) == ("5.333", "8.000")


def test_messages_are_late_beside_their_usual_age_by_the_clock_of_this_computer(clock):
    """A stream of another clock, one that is replayed slowly, and one by simulated time have no age to judge by."""
    for usual, simulated, is_late in (
        (0.004, False, True),
        (-0.3, False, True),
        (2.0, False, False),
        (1e9, False, False),
        (0.004, True, False),
    ):
        meter = InputMeter(max_gap=0.1)
        meter.is_simulated = simulated
        clock.receive(meter, 10, 0.1, age=usual + 0.5)
        assert not meter.is_late  # nothing is known yet
        clock.receive(meter, 10, 0.1, age=usual)
        meter.report_rate()
        clock.receive(meter, 1, 0.01, age=usual + 0.09)
        assert not meter.is_late
        clock.receive(meter, 1, 0.01, age=usual + 0.5)
        assert meter.is_late is is_late
        told = "came up to 0.50 s later than usual: answers were flagged (STALE_INPUT)"
        assert (meter.report_rate()[1] == (WARN, told)) is is_late
        for _ in range(5):  # a latency that stays is usual
            clock.receive(meter, 10, 0.1, age=usual + 0.5)
            meter.report_rate()
        clock.receive(meter, 1, 0.1, age=usual + 0.5)
        assert not meter.is_late


@pytest.mark.parametrize("bit", [bit for bit in Status if bit])
def test_usable_is_said_of_the_newest_answer(bit, clock):
    def said():
        _, values, (level, _) = clock.health.usability_entry()
        return values["usable"], values["because"], level

    assert said() == ("false", "no answer yet", STALE)
    clock.answer(bit)
    harmless = bit in (Status.INPUT_REJECTED, Status.DOUBTFUL_LOAD)
    assert said() == (("true", "", OK) if harmless else ("false", bit.name, WARN))
    clock.answer()
    assert said() == ("true", "", OK)
    clock.now += 1.1
    assert said() == ("false", "no answer for 1.1 s", STALE)
