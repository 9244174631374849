"""Random disturbances of the stamps, against a plain account of what every good sample must get (`studies/pairing`)."""

from collections.abc import Callable
from typing import Any

import pytest

from knee_contact_ros.streams.pairing import Synchroniser
from knee_contact_ros.streams.timeline import Timeline
from studies.pairing.judging import judged

WORLDS = range(10_112, 10_136)
"""Seeds: 288 disturbances"""


def breaches(seeds):
    """What goes wrong in these worlds."""
    found = [judged(seed) for seed in seeds]
    return [(seed, breach.what, breach.kind) for seed, world in found for breach in world.breaches]


def test_every_good_sample_gets_what_it_must():
    assert breaches(WORLDS) == []


def test_a_lead_of_half_a_second_before_a_restart_is_no_measure():
    """Both streams restart one after the other: what lies between was taken for familiar, for ever after."""
    assert breaches([6_001_214, 6_003_148]) == []


def accept_all(self, sample, _other):
    """One stamp ahead, and all that come after it are late; one behind, and the stream begins anew."""
    if self.last is not None and 0 <= self.last - sample.stamp <= self._max_gap:
        self._refused.count_refused("angle_not_in_order")
        return []
    self._advance_to(sample.stamp)
    return [sample]


def accept_no_jump(self, sample, _other):
    """A clock that is set is not accepted any more."""
    if self.last is not None and not 0 < sample.stamp - self.last <= 5 * self._max_gap:
        self._refused.count_refused("angle_off_time")
        return []
    self._advance_to(sample.stamp)
    return [sample]


def flush_all(self, _arrived_by=0.0):
    """Also loads that have only just come."""
    return self._make_pairs(len(self.waiting_loads), hold=True)


def keep_old_angles(self, samples):
    """Where angles have jumped back, those of before stay in the way."""
    self.angles.extend(samples)
    self.unpaired_angles.extend(samples)
    return self._make_pairs(len(self.waiting_loads))


FAULTS: dict[str, tuple[type, str, Callable[..., Any]]] = {
    "every stamp is accepted": (Timeline, "push_sample", accept_all),
    "no jump is accepted": (Timeline, "push_sample", accept_no_jump),
    "the other stream is not looked at": (Timeline, "has_reached", lambda _self, _stamp: False),
    "nothing held back is checked again": (
        Timeline,
        "recheck_held_back",
        lambda _self, _other, jumped=False: [],
    ),
    "a load is held too soon": (Synchroniser, "flush_expired", flush_all),
    "angles of before a jump are kept": (Synchroniser, "_pairs_with_angles", keep_old_angles),
    "nothing held back is accepted": (Timeline, "_acceptable", lambda _self, _other: 0),
}


@pytest.mark.parametrize("fault", FAULTS)
def test_each_fault_put_back_is_found(monkeypatch, fault):
    owner, name, wrong = FAULTS[fault]
    monkeypatch.setattr(owner, name, wrong)
    assert any(breaches(range(seed, seed + 4)) for seed in WORLDS[::4])
