"""The topic `knee_contact/markers`: the newest answer for RViz, while somebody subscribes."""

from __future__ import annotations

from typing import Any

from knee_contact_ros.streams.pairing import LoadSample
from knee_contact_ros.view.markers import KneeMarkers

MARKER_PERIOD = 1.0 / 30.0
"""Shortest time [s] from one message to the next"""
MARKER_DEPTH = 1
"""Number of messages that the publisher keeps: an old picture is of no use"""


class MarkerTopic:
    """Publishes markers between ticks, and not with every tick."""

    def __init__(self, publisher: Any, markers: KneeMarkers) -> None:
        """Publish `markers` with the publisher of a MarkerArray."""
        self.publisher = publisher
        self.newest: tuple[LoadSample, bytes] | None = None
        """The answer to show next: its load, and the bytes of its row; None if it has been shown"""
        self._markers = markers

    def publish(self) -> None:
        """Publish the newest answer, unless nobody subscribes or it has been published."""
        if self.newest and self.publisher.get_subscription_count():
            load, row = self.newest
            self.newest = None
            self.publisher.publish(self._markers.encode(load.stamp, load.frame_id, row))
