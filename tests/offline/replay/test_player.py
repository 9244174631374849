"""When messages go out, and what keys do to it; the keys are a script, the clock is the real one."""

import time

import pytest

from knee_contact_ros.bags.bag import RawMessage
from knee_contact_ros.commands.player import Command, Lateness, Player, with_due_times

MILLISECOND = 1_000_000
BEGIN = 1_700_000_000_000_000_000


def bag(count, period=5 * MILLISECOND):
    """Messages of two topics, in pairs."""
    return [
        RawMessage(topic, BEGIN + i * period, b"%d" % i)
        for i in range(count)
        for topic in ("/a", "/b")
    ]


class Keys:
    """Presses keys one after another, each in a wait of its own; a wait without keys lasts."""

    def __init__(self, *presses):
        self.presses = list(presses)

    def __call__(self, seconds):
        keys = self.presses.pop(0) if self.presses else ()
        if not keys:
            time.sleep(seconds)
        return keys


@pytest.mark.parametrize("rate", [1.0, 4.0])
def test_no_message_goes_out_before_its_time_and_none_is_lost(rate):
    messages = bag(60)
    before = time.perf_counter()
    sent = [
        (message, lateness, time.perf_counter())
        for message, lateness in Player(rate=rate).play(messages)
    ]
    assert [message for message, _, _ in sent] == messages
    for message, lateness, when in sent:
        after = (message.log_time - BEGIN) / 1e9 / rate
        assert when - before >= after - 1e-9  # rounding of times of some days
        assert lateness is not None
        assert lateness >= 0.0


def test_a_message_that_comes_too_late_goes_out_at_once():
    def messages():
        yield from bag(2)
        time.sleep(0.1)  # the disk was slow
        yield from bag(4)[4:]

    late = [lateness for _, lateness in Player().play(messages())]
    assert min(late[4:]) > 0.05  # 10 and 15 ms after the beginning they were due
    assert max(late[:2]) < min(late[4:])


def test_keys_pause_step_and_go_on():
    sent = []
    states = []
    steps = Keys([Command.STEP], [Command.STEP, Command.STEP], [Command.PAUSE])
    player = Player(
        steps, paused=True, on_change=lambda rate, paused: states.append((rate, paused, len(sent)))
    )
    late = []
    for message, lateness in player.play(bag(4)):
        sent.append(message)
        late.append(lateness)
    assert sent == bag(4)
    assert late[:3] == [None] * 3
    assert None not in late[3:]
    assert states == [(1.0, False, 3)]


def test_a_pause_lasts_until_the_next_key_and_what_follows_is_not_late():
    class PauseAtOnce(Keys):
        def __call__(self, seconds):
            if len(self.presses) == 1:
                time.sleep(0.3)
            return super().__call__(seconds)

    began = time.perf_counter()
    player = Player(PauseAtOnce([Command.PAUSE], [Command.PAUSE]))
    late = [lateness for _, lateness in player.play(bag(10))]
    assert time.perf_counter() - began > 0.3
    assert sum(late) / len(late) < 0.15  # 0.3 s each if the pause counted


def test_the_rate_goes_up_and_down_by_the_same_factor_within_its_limits():
    rates = []
    keys = Keys(
        [Command.FASTER],
        [Command.FASTER],
        [Command.SLOWER],
        [Command.SLOWER],
        [Command.SLOWER] * 100,
    )
    keys.presses.append([Command.PAUSE])
    player = Player(keys, paused=True, on_change=lambda rate, _paused: rates.append(rate))
    for _ in player.play(bag(1)):
        pass
    assert rates[:4] == pytest.approx([1.1, 1.21, 1.1, 1.0])
    assert rates[-1] == 0.01
    assert player.rate == 0.01  # it stays for the next time through the bag


def test_the_clock_ticks_at_its_own_rate_also_in_pauses():
    told = []
    keys = Keys([], [], [], [], [Command.PAUSE])
    player = Player(keys, paused=True, publish_time=told.append, clock_rate=100.0)
    for _ in player.play(bag(2, 300 * MILLISECOND)):
        pass
    assert told == sorted(told)
    assert told[0] == told[1] == BEGIN  # while it was paused
    assert BEGIN < told[-1] <= BEGIN + 310 * MILLISECOND
    assert 10 < len(told) <= 60  # 30 and those in the pause; a busy machine may leave some out
    assert len(set(told)) > 10


def stamped(log_time, stamp):
    data = (
        b"\x00\x01\x00\x00"
        + (stamp // 10**9).to_bytes(4, "little")
        + (stamp % 10**9).to_bytes(4, "little")
    )
    return RawMessage("/a", log_time, data)


def test_equal_log_times_are_paced_by_the_stamps(
    capsys,
):
    """A recorder that waited for /clock: log times of 0, then those of today; and a clock that is set back later."""
    first = [stamped(0, BEGIN + i * 20 * MILLISECOND) for i in range(6)]
    today = [
        stamped(BEGIN + i * 20 * MILLISECOND, BEGIN + (6 + i) * 20 * MILLISECOND) for i in range(6)
    ]
    back = [stamped(BEGIN - 10**12 + i * 20 * MILLISECOND, BEGIN) for i in range(6)]
    day = [stamped(BEGIN + 86_400 * 10**9, BEGIN)]
    sent = [time.perf_counter() for _ in Player().play([*first, *today, *back, *day])]
    assert len(sent) == 19
    assert sent[-1] - sent[0] > 0.29
    assert [due for _, due in with_due_times(first)] == [i * 20 * MILLISECOND for i in range(6)]
    told = [round(float(line.split()[4])) for line in capsys.readouterr().err.splitlines()]
    assert told == [BEGIN // 10**9, 87_400]


def test_lateness_is_counted_and_printed():
    lateness = Lateness()
    for seconds in (0.0, 0.0005, 0.0021, None, 0.0001, 0.0002, 0.0003):
        lateness.count_message(seconds)
    assert (lateness.messages, lateness.late, lateness.largest, lateness.drift) == (
        7,
        1,
        0.0021,
        0.0003,
    )
    assert str(lateness) == (
        "7 messages published, 1 (14.3 %) later than 1 ms, the latest by 2.10 ms; drift at the end 0.30 ms"
    )
