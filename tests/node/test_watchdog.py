"""A node that stands still is noticed."""

import socket

from knee_contact_ros.node import watchdog
from tests.helpers.patience import patience, wait_until


def test_a_standstill_is_told(monkeypatch, tmp_path):
    """To the service manager also the start, work and the end."""
    monkeypatch.setattr(watchdog, "SIGN_PERIOD", 0.0)
    monkeypatch.setattr(watchdog, "STANDSTILL", 0.01)
    monkeypatch.setenv("NOTIFY_SOCKET", str(tmp_path / "notify"))
    ages = []
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as manager:
        manager.bind(str(tmp_path / "notify"))
        manager.settimeout(patience())
        dog = watchdog.Watchdog([ages.append])
        wait_until(lambda: ages)
        assert ages[0] > 0.01
        dog.note_life()
        dog.end()
        told = [manager.recv(100) for _ in range(3)]
    assert told == [b"READY=1", b"WATCHDOG=1", b"STOPPING=1"]
