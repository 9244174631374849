"""What sessions in one process have in common."""

from __future__ import annotations

import gc
from types import SimpleNamespace
from typing import Any

from knee_contact_ros.node.session import Session


class Silent(Session):
    """Does nothing while it streams."""

    def __init__(self) -> None:
        parameters = SimpleNamespace(pairing=SimpleNamespace(wait=0.1))
        anything: Any = SimpleNamespace(ticks=0, start_timer=lambda: None)
        super().__init__(anything, parameters, anything, anything)
        self.inputs: Any = ()

    _publish = _described = _go_on_with = lambda *_: None  # type: ignore[assignment]

    def _regular_acts(self) -> list[Any]:
        return []


def test_the_garbage_collector_is_off_as_long_as_one_streams() -> None:
    """Also when the other one ends first, and when one ends that was never started."""
    first, second, third = Silent(), Silent(), Silent()
    try:
        first.start()
        second.start()
        assert not gc.isenabled()
        first.stop()
        third.stop()
        assert not gc.isenabled()
        first.start()
        second.stop()
        assert not gc.isenabled()
        first.stop()
        assert gc.isenabled()
        assert not gc.get_freeze_count()
    finally:
        Session.streaming.clear()
        gc.enable()
        gc.unfreeze()
