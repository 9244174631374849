"""The topic `knee_contact/markers`: the newest answer as RViz draws it, while somebody looks."""

from __future__ import annotations

from typing import Any

from knee_contact_ros.pipeline.samples import LoadSample
from knee_contact_ros.view.markers import KneeMarkers

MARKER_PERIOD = 1.0 / 30.0
"""How often [s] there may be a new picture"""
MARKER_DEPTH = 1
"""Messages that the publisher keeps: an old picture is of no use"""


class MarkerTopic:
    """Publishes pictures between ticks, and not with every tick."""

    def __init__(self, publisher: Any, markers: KneeMarkers) -> None:
        """Publish markers on the publisher of a MarkerArray."""
        self.publisher = publisher
        self.newest: tuple[LoadSample, bytes] | None = None
        """The answer to be shown next: the load that it is the answer to, and the bytes of its row"""
        self._markers = markers

    def publish(self) -> None:
        """Show the newest answer, unless nobody looks or it was shown already."""
        if self.newest and self.publisher.get_subscription_count():
            load, row = self.newest
            self.newest = None
            self.publisher.publish(self._markers.encode(load.stamp, load.frame_id, row))
