"""A little series of samples, and how it is sent."""

from __future__ import annotations

import numpy as np

from tests.ros.conftest import Peer

STEP = 5_000_000
STAMPS = np.arange(40) * STEP
ANGLES = 0.2 + 0.3 * np.sin(STAMPS * 3e-9)
AXIAL = 1500.0 + 900.0 * np.sin(STAMPS * 2e-8)


def send_all(peer: Peer) -> None:
    """Publish the little series above and wait for its answers."""
    for stamp, angle, axial in zip(STAMPS.tolist(), ANGLES.tolist(), AXIAL.tolist(), strict=True):
        peer.send(stamp, angle, axial)
    peer.wait_until(lambda: len(peer.contacts) == len(STAMPS) and len(peer.wrenches) == len(STAMPS))
