"""What is done in a thread: in its order, one thing at a time, and no error is lost."""

from __future__ import annotations

from threading import Event, current_thread

import pytest

from knee_contact_ros.offline.solve import Behind


def test_things_are_done_in_another_thread_in_their_order() -> None:
    done: list[int] = []
    with Behind() as behind:
        for number in range(100):
            behind.do(done.append, number)
        behind.wait()
        assert done == list(range(100))
        names: list[str] = []
        behind.do(lambda: names.append(current_thread().name))
        behind.wait()
    assert names != [current_thread().name]


def test_the_caller_goes_on_meanwhile() -> None:
    with Behind() as behind:
        go, gone = Event(), Event()
        behind.do(lambda: (go.wait(30.0), gone.set()))
        assert not gone.is_set()
        go.set()
    assert gone.is_set()  # the end waits


def fail() -> None:
    raise OSError("disk full")


@pytest.mark.parametrize("asked", ["wait", "do"])
def test_an_error_comes_with_what_is_asked_next_and_once(asked: str) -> None:
    done: list[int] = []
    with Behind() as behind:
        behind.do(fail)
        with pytest.raises(OSError, match="disk full"):
            behind.wait() if asked == "wait" else behind.do(done.append, 1)
        behind.wait()
    assert done == []
