"""Setting the time cursor of a viewer to the largest load: a file cannot do it (Rerun 0.41), but a program can."""

from __future__ import annotations

import time
from contextlib import suppress
from pathlib import Path
from threading import Thread
from typing import NamedTuple

import numpy as np
from rerun.chunk import RrdReader
from rerun.experimental import ViewerClient

from knee_contact_ros.view.plots import FORCE_PLACE, FORCES, LOAD_PLACE
from knee_contact_ros.view.scene import CURVES, TIMELINE

PATIENCE = 60.0
"""Time [s] that a viewer may take to load a file"""
PAUSE = 0.1
"""Time [s] between two requests for the viewer's state"""


class Moment(NamedTuple):
    """A moment of a scene."""

    stamp: int
    """Stamp [ns]"""
    is_date: bool
    """Whether the timeline shows dates, and not durations"""


def peak_of(path: Path) -> Moment | None:
    """Return when the load of any knee in a Rerun file is largest; among equal loads, when the contact force is.

    Where no load is drawn, the contact force counts. Returns None if the file has no curves of forces.
    """
    peaks: list[tuple[float, float, Moment]] = []
    for chunk in RrdReader(path).stream():
        if chunk.entity_path.endswith(f"/{CURVES}/{FORCES}") and not chunk.is_static:
            batch = chunk.to_record_batch()
            stamps = batch.column(TIMELINE)
            curves = np.nan_to_num(np.array(batch.column("Scalars:scalars").to_pylist()), nan=-np.inf)
            force = curves[:, FORCE_PLACE]
            load = curves[:, LOAD_PLACE] if curves.shape[1] > LOAD_PLACE else force  # none where the height drives
            best = int(np.lexsort((-np.arange(len(load)), force, load))[-1])
            moment = Moment(stamps.cast("int64")[best].as_py(), str(stamps.type).startswith("timestamp"))
            peaks.append((float(load[best]), float(force[best]), moment))
    return max(peaks)[-1] if peaks else None


def put_on_peak(path: Path, viewer: str) -> None:
    """Set the cursor in a thread, once the viewer at an address has loaded the file; errors are ignored."""
    Thread(target=_put, args=(path, viewer), name="cursor", daemon=True).start()


def _put(path: Path, viewer: str) -> None:
    with suppress(Exception):  # nothing depends on it: the viewer may be gone, or the file be none of ours
        moment = peak_of(path)
        if moment:
            client = _loaded(viewer)
            if moment.is_date:
                client.set_time(TIMELINE, timestamp=np.datetime64(moment.stamp, "ns"), play_state="paused")
            else:
                client.set_time(TIMELINE, duration=np.timedelta64(moment.stamp, "ns"), play_state="paused")


def _loaded(viewer: str) -> ViewerClient:
    """Return the client of a viewer once it has loaded its file.

    Raises:
        TimeoutError: the viewer was not ready in time.
    """
    end = time.monotonic() + PATIENCE
    while time.monotonic() < end:
        with suppress(Exception):  # nobody answers yet; the library raises what it likes
            client = ViewerClient.connect(viewer)
            state = client.get_state()
            if state.views and not state.loading and any(item.timelines for item in state.recordings):
                return client
        time.sleep(PAUSE)
    raise TimeoutError
