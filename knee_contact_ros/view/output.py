"""The scene as a sink's process writes it (`protocol.Output`)."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from knee_contact_ros.core.types import ROW
from knee_contact_ros.messages.answer import Ending
from knee_contact_ros.system.output_files import all_names, cut_off, leftovers, refuse_impossible
from knee_contact_ros.view.outlets import Outlet, RerunFile, Served
from knee_contact_ros.view.outlines import KneeOutlines, Serving
from knee_contact_ros.view.scene import Scene
from knee_contact_ros.view.window import Window, address, open_window

BATCH = 1000
"""Answers per message to Rerun at most: one costs as much as a hundred."""
FILE_PERIOD, LIVE_PERIOD = 0.5, 0.1
"""How long [s] a batch waits to be full: in a file, and before somebody's eyes"""
PAUSE = 0.0005
"""[s] between two messages to Rerun beside a node: the longest time that it may find a processor taken is one's"""


class Viewer:
    """Shows answers in batches."""

    def __init__(
        self,
        outlet: Outlet,
        scene: Scene,
        period: float,
        remarks: Sequence[str] = (),
        window: Window | None = None,
    ) -> None:
        """Show on an outlet.

        `period` [s] is how long a batch waits to be full, `remarks` are what the user shall know of the beginning, and
        `window` is the viewer on this machine, if one was opened.
        """
        self.period, self.name = period, outlet.name
        self._outlet, self._scene, self._window = outlet, scene, window
        self._remarks = tuple(remarks)
        self._batch: list[bytes] = []

    def write(self, row: bytes) -> None:
        """Show an answer's row."""
        self._batch.append(row)
        if len(self._batch) == BATCH:
            self._show()

    def note(self, name: str, values: dict[str, str]) -> None:
        """Show that something happened between two answers."""
        self._show()
        self._scene.note(name, values)

    def flush(self) -> None:
        """Show what waits."""
        self._show()
        self._outlet.flush()

    def must_end(self) -> str:
        """Only a full disk ends it, and `flush` tells that."""
        return ""

    def news(self) -> tuple[str, ...]:
        """The remarks, once, and that the viewer on this machine is gone."""
        news, self._remarks = self._remarks, ()
        return news + (self._window.news() if self._window else ())

    def finish(self, ending: Ending | None) -> None:  # noqa: ARG002  (inputs alone are not shown)
        """Show what waits and complete it."""
        self._show()
        self._scene.finish()
        self._outlet.close()
        self.name = self._outlet.name

    def discard(self) -> None:
        """Leave nothing behind."""
        self._outlet.discard()
        if self._window:
            self._window.close()

    def _show(self) -> None:
        if self._batch:
            self._scene.show(np.frombuffer(b"".join(self._batch), ROW))
            self._batch = []


def open_output(path: Path | None, serving: Serving, drawing: KneeOutlines) -> Viewer:
    """Open what a sink's process shows a knee on: a file, or without a `path` a server.

    Raises:
        UsageError: see `RerunFile`, `Served` and `open_window`.
    """
    remarks = []
    if path:
        refuse_impossible(path)
        name = next(all_names(path))
        if name != path:
            remarks.append(f"{path} is there already: this Rerun recording is {name}")
        remarks += map(cut_off, leftovers(path.parent, ".rrd"))
        outlet: Outlet = RerunFile(name, [drawing], latency=True)
    else:
        # The others' surfaces are not known here; where they are looked at is much the same.
        drawings = [drawing._replace(knee=name) for name in serving.knees or [drawing.knee]]
        outlet = Served(serving.port, drawings, "+".join(serving.knees) or None)
    window = open_window(address(serving.port)) if serving.window and not path else None
    number = serving.knees.index(drawing.knee) if len(serving.knees) > 1 and not path else None
    scene = Scene(outlet.recording, drawing, latency=True, pause=PAUSE, forgetful=not path, number=number)
    return Viewer(outlet, scene, FILE_PERIOD if path else LIVE_PERIOD, remarks, window)
