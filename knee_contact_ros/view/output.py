"""The scene as an output in a process of its own (`sinks.protocol.Output`)."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from knee_contact_ros.messages.answer import Ending
from knee_contact_ros.model.types import ROW
from knee_contact_ros.system.output_files import all_names, cut_off, leftovers, refuse_impossible
from knee_contact_ros.view.outlets import Outlet, RerunFile, Served
from knee_contact_ros.view.outlines import KneeOutlines, Serving
from knee_contact_ros.view.scene import Scene
from knee_contact_ros.view.window import Window, address, open_window

BATCH = 4000
"""Number of answers that are shown at once: a message to Rerun costs as much as hundreds of answers"""
FILE_PERIOD, LIVE_PERIOD = 1.0, 0.1
"""Time [s] that a batch waits to be full, for a file and for a live viewer"""
PAUSE = 0.0005
"""Pause [s] between two messages to Rerun beside a node, which gets the processor then"""


class Viewer:
    """An output that shows answers in batches."""

    def __init__(
        self,
        outlet: Outlet,
        scenes: Sequence[Scene],
        period: float,
        remarks: Sequence[str] = (),
        window: Window | None = None,
    ) -> None:
        """Show each compartment in one of the `scenes`, which write to `outlet`.

        A batch waits for `period` [s] to be full. `remarks` are messages to the user about the opening, and `window` is
        the viewer on this machine, if one was opened.
        """
        self.period, self.name = period, outlet.name
        self._outlet, self._scenes, self._window = outlet, scenes, window
        self._remarks = tuple(remarks)
        self._batch: list[bytes] = []

    def write(self, parts: Sequence[bytes]) -> None:
        """Add the rows of answers to the batch, and show it if it is full."""
        self._batch += parts
        if len(self._batch) >= BATCH:
            self._show()

    def note(self, name: str, values: dict[str, str]) -> None:
        """Show a note on something that happened between two answers."""
        self._show()
        for scene in self._scenes:
            scene.note(name, values)

    def flush(self) -> None:
        """Show the waiting answers, and hand them over."""
        self._show()
        self._outlet.flush()

    def must_end(self) -> str:
        """Return an empty text: only a full disk ends this output, which `flush` reports."""
        return ""

    def news(self) -> tuple[str, ...]:
        """Return messages to the user, each once: remarks, and that the viewer on this machine has ended."""
        news, self._remarks = self._remarks, ()
        return news + (self._window.news() if self._window else ())

    def finish(self, ending: Ending | None) -> None:  # noqa: ARG002  (inputs alone are not shown)
        """Show the waiting answers, and complete the file."""
        self._show()
        for scene in self._scenes:
            scene.finish()
        self._outlet.close()
        self.name = self._outlet.name

    def discard(self) -> None:
        """Give up: leave no file, and close the window."""
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
    """Open the output for a knee of one or two compartments: a file, or a server if there is no `path`.

    Raises:
        UsageError: the output cannot be opened; see `RerunFile`, `Served` and `open_window`.
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
    names = [drawing.knee for drawing in own] if path else serving.knees
    scenes = [
        Scene(
            outlet.recording, drawing, latency=True, pause=PAUSE, forgetful=not path,
            number=names.index(drawing.knee) if len(names) > 1 else None,
        )
        for drawing in own
    ]  # fmt: skip
    return Viewer(outlet, scenes, FILE_PERIOD if path else LIVE_PERIOD, remarks, window)
