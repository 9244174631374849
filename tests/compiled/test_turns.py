"""One process compiles, and the others wait: as long as that helps, and whatever becomes of the one."""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ProcessPoolExecutor, ThreadPoolExecutor
from contextlib import ExitStack
from pathlib import Path

import pytest

from knee_contact_ros.compiled import turns
from knee_contact_ros.compiled.kernel_folder import KernelFolder
from knee_contact_ros.compiled.turns import in_turn, wait_for_turn
from tests.helpers.tiny_kernel import FORKS, use_in_turn

pytestmark = pytest.mark.xdist_group("tiny kernel")
SOON = 5.0
"""[s] that nothing here takes if it does not wait"""


@pytest.fixture
def folder(tmp_path: Path) -> KernelFolder:
    return KernelFolder(tmp_path / "home" / "kernel-1")


@pytest.fixture
def other(folder: KernelFolder) -> Iterator[Callable[[], Future[float]]]:
    """Has another one take its turn; gives how long [s] that waited."""

    def taken() -> float:
        begun = time.monotonic()
        with in_turn(lambda: "it"):
            wait_for_turn(folder, "file")
            waited = time.monotonic() - begun
            unlock = folder.lock("it")  # who waits is no one to wait for
            assert unlock
            unlock()
        return waited

    with ThreadPoolExecutor() as pool:
        yield lambda: pool.submit(taken)


def test_whoever_comes_later_waits_for_the_file(folder: KernelFolder) -> None:
    def waited() -> float:
        begun = time.monotonic()
        with in_turn(lambda: "it"):
            wait_for_turn(folder, "file")
        return time.monotonic() - begun

    with in_turn(lambda: "it"), ThreadPoolExecutor() as pool:
        wait_for_turn(folder, "file")
        later = pool.submit(waited)
        time.sleep(0.3)
        assert not later.done()
        folder.write("file", b"kernel")  # it is waited for no longer, though the turn has not ended
        assert 0.2 < later.result(SOON) < SOON


@pytest.mark.parametrize("error", [ValueError, KeyboardInterrupt])
def test_a_turn_that_fails_ends(
    folder: KernelFolder, other: Callable[[], Future[float]], error: type[BaseException]
) -> None:
    later: list[Future[float]] = []

    def fail() -> None:
        with in_turn(lambda: "it"):
            wait_for_turn(folder, "file")
            later.append(other())
            time.sleep(0.3)
            raise error

    with pytest.raises(error):
        fail()
    assert 0.2 < later[0].result(SOON) < SOON
    begun = time.monotonic()
    with in_turn(lambda: "it"):  # again, by the one that has failed
        wait_for_turn(folder, "file")
    assert time.monotonic() < begun + SOON


def test_who_stands_still_is_not_waited_for_for_long(folder: KernelFolder, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(turns, "PATIENCE", 0.3)
    unlock = folder.lock("it")
    assert unlock
    begun = time.monotonic()
    with in_turn(lambda: "it"):
        wait_for_turn(folder, "file")
        wait_for_turn(folder, "another file of the same kernel")
    assert 0.3 <= time.monotonic() - begun < 0.6
    unlock()


def test_a_child_does_not_keep_a_turn(folder: KernelFolder) -> None:
    unlock = folder.lock("it")
    assert unlock
    child = os.fork()
    if not child:
        time.sleep(SOON)
        os._exit(0)
    unlock()
    again = folder.lock("it")
    os.kill(child, 9)
    os.waitpid(child, 0)
    assert again
    again()


def test_what_cannot_be_locked_is_not_waited_for(folder: KernelFolder) -> None:
    folder.write("file", b"kernel")
    (folder.path / ".it.lock").mkdir()
    begun = time.monotonic()
    with in_turn(lambda: "it"):
        wait_for_turn(folder, "another")
    wait_for_turn(folder, "another")  # nor out of turn
    assert time.monotonic() < begun + SOON


def test_of_two_processes_one_compiles(tmp_path: Path) -> None:
    with ExitStack() as stack:
        pools = [stack.enter_context(ProcessPoolExecutor(1, mp_context=FORKS)) for _ in range(2)]
        begun = [pool.submit(use_in_turn, tmp_path, 21.0) for pool in pools]
        outcomes = [one.result() for one in begun]
    assert [(outcome.answer, outcome.said) for outcome in outcomes] == [(42.0, [])] * 2
    assert sorted(outcome.loaded for outcome in outcomes) == [False, True]
