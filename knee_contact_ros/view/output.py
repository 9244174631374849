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

BATCH = 4000
"""Answers from which on they are shown at once: few messages to Rerun, as one costs as much as hundreds of answers"""
FILE_PERIOD, LIVE_PERIOD = 1.0, 0.1
"""How long [s] a batch waits to be full: in a file, and before somebody's eyes"""
PAUSE = 0.0005
"""[s] between two messages to Rerun beside a node: the longest time that it may find a processor taken is one's"""


class Viewer:
    """Shows answers in batches."""

    def __init__(
        self,
        outlet: Outlet,
        scenes: Sequence[Scene],
        period: float,
        remarks: Sequence[str] = (),
        window: Window | None = None,
    ) -> None:
        """Show on an outlet: each compartment in one of the `scenes`.

        `period` [s] is how long a batch waits to be full, `remarks` are what the user shall know of the beginning, and
        `window` is the viewer on this machine, if one was opened.
        """
        self.period, self.name = period, outlet.name
        self._outlet, self._scenes, self._window = outlet, scenes, window
        self._remarks = tuple(remarks)
        self._batch: list[bytes] = []

    def write(self, parts: Sequence[bytes]) -> None:
        """Show answers' rows."""
        self._batch += parts
        if len(self._batch) >= BATCH:
            self._show()

    def note(self, name: str, values: dict[str, str]) -> None:
        """Show that something happened between two answers."""
        self._show()
        for scene in self._scenes:
            scene.note(name, values)

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
        for scene in self._scenes:
            scene.finish()
        self._outlet.close()
        self.name = self._outlet.name

    def discard(self) -> None:
        """Leave nothing behind."""
        self._outlet.discard()
        if self._window:
            self._window.close()

    def _show(self) -> None:
        if self._batch:
            rows = np.frombuffer(b"".join(self._batch), ROW)
            for first, scene in enumerate(self._scenes):
                scene.show(rows[first :: len(self._scenes)])
            self._batch = []


def open_output(path: Path | None, serving: Serving, own: Sequence[KneeOutlines]) -> Viewer:
    """Open what a sink's process shows a knee, of one compartment or two, on: a file, or without a `path` a server.

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
        outlet: Outlet = RerunFile(name, own, latency=True)
    else:
        # The others' surfaces are not known here; where they are looked at is much the same.
        known = {drawing.knee: drawing for drawing in own}
        drawings = [known.get(name, own[0]._replace(knee=name)) for name in serving.knees or known]
        outlet = Served(serving.port, drawings, "+".join(serving.knees) or None)
    window = open_window(address(serving.port)) if serving.window and not path else None
    shown = [drawing.knee for drawing in own] if path else serving.knees
    scenes = [
        Scene(
            outlet.recording, drawing, latency=True, pause=PAUSE, forgetful=not path,
            number=shown.index(drawing.knee) if len(shown) > 1 else None,
        )
        for drawing in own
    ]  # fmt: skip
    return Viewer(outlet, scenes, FILE_PERIOD if path else LIVE_PERIOD, remarks, window)
