"""The scene of one knee in a Rerun recording, written batch by batch."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any

import numpy as np
import rerun as rr

from knee_contact_ros.messages.stamps import NANOSECONDS
from knee_contact_ros.model.readouts import SPREAD, Readings
from knee_contact_ros.model.types import Rows, blank
from knee_contact_ros.results.columns import DATES_FROM
from knee_contact_ros.view import sagittal
from knee_contact_ros.view.colours import APART, BONE, CARTILAGE, KNEE_COLOURS, NAME_OF_STATE, Colour
from knee_contact_ros.view.frame import frame_of
from knee_contact_ros.view.outlines import KneeOutlines
from knee_contact_ros.view.plots import LAYER, LAYER_COLOUR, LAYER_NAME, MM, plots_of
from knee_contact_ros.view.remarks import Remark, Remarks, remark_of_note

TIMELINE = "stamp"
CURVES, EVENTS, STATES = "curves", "events", "states"
CONTACT, LEVEL = "contact", "level"
LEVEL_NAMES = ("quasi-static", "first-order", "dynamic")
"""Names of the levels, by `Fidelity`"""
LEVEL_COLOURS = [(90, 100, 120), (125, 140, 170), (165, 190, 225)]
REPEAT = 5 * NANOSECONDS
"""Time [ns] after which a lasting state is written again, where old data is dropped"""
SINGLE = 5.0
"""Radius of the point that stands for the curve of a single answer"""
LAYER_DEPTH = "contact.layer_depth"
LAW = ("contact.", "lateral.contact.")
"""Beginnings of the names of parameters on which patch, pressure and strain depend"""


class Scene:
    """Writes a knee's answers into a Rerun recording."""

    def __init__(
        self,
        recording: rr.RecordingStream,
        drawing: KneeOutlines,
        latency: bool = False,
        pause: float = 0.0,
        forgetful: bool = False,
        number: int | None = None,
    ) -> None:
        """Write the parts of the scene that do not change.

        Args:
            recording: Rerun's recording.
            drawing: Outlines of the knee.
            latency: Whether the answers have latencies.
            pause: Pause [s] between two messages to Rerun.
            forgetful: Whether old data is dropped, so that states are repeated.
            number: Number of the knee among several in one scene, for the colour of its curves; None: it is alone.
        """
        self._recording, self._drawing, self._pause = recording, drawing, pause
        self._plots, self._number = plots_of(drawing, latency), number
        self._layer = drawing.second_layer
        self._pictures = sagittal.Pictures()
        self._remarks = Remarks(drawing.body_weight)
        self._time = _durations
        self._last_stamp = 0
        self._begun, self._alone, self._has_events = False, True, False
        self._before, self._law_known = blank(0), True
        self._early: list[tuple[str, Mapping[str, str]]] = []
        """Notes that came before the first answer, whose stamp they get"""
        self._states: dict[str, int] = {}
        self._repeat = REPEAT if forgetful else math.inf
        self._written: dict[str, int] = {}
        """Stamps [ns] of the states that were written last"""
        self._write_still()

    def show(self, answers: Rows) -> None:
        """Write answers, at least one."""
        self._alone = not self._begun and len(answers) == 1
        if not self._begun:
            self._begin(int(answers["stamp"][0]))
        self._last_stamp = int(answers["stamp"][-1])
        read = self._read_off(answers)
        for plot in self._plots:
            source: Any = read if plot.read_off else answers
            values = np.stack([series.values(source, self._drawing.body_weight) for series in plot.series], axis=1)
            known = np.isfinite(values[:, 0]) if plot.read_off else np.ones(len(values), dtype=bool)
            if not known.any():
                continue
            values = values[known]
            columns = rr.Scalars.columns(scalars=values.ravel())
            if values.shape[1] > 1:
                columns = columns.partition(np.full(len(values), values.shape[1]))
            self._send(f"{CURVES}/{plot.path}", answers["stamp"][known], columns)
        if math.isfinite(self._layer):
            ends = answers["stamp"][[0, -1]]
            self._send(f"{CURVES}/{LAYER}", ends, rr.Scalars.columns(scalars=[MM * self._layer] * 2))
        pictures = self._pictures.choose(answers["stamp"])
        if len(pictures):
            drawn = answers[pictures]
            sagittal.send_moving_plane(self._drawing, drawn, self._layer, self._to(sagittal.BODY, drawn["stamp"]))
            sagittal.send_moving_marks(self._drawing, drawn, self._to(sagittal.CAMERA, drawn["stamp"]))
        self._write_changes(CONTACT, answers["stamp"], answers["contact_state"], list(NAME_OF_STATE.values()))
        self._write_changes(LEVEL, answers["stamp"], answers["fidelity"], LEVEL_NAMES)
        self._write_events(self._remarks.take(answers))

    def note(self, name: str, values: Mapping[str, str]) -> None:
        """Write a note on something that happened to the node after the answers so far."""
        if LAYER_DEPTH in values and math.isfinite(self._layer):
            self._layer = float(values[LAYER_DEPTH])
        self._law_known &= not any(name.startswith(LAW) for name in values)
        if not self._begun:
            self._early.append((name, values))
            return
        self._write_events([remark_of_note(self._last_stamp, name, values)])

    def _read_off(self, answers: Rows) -> Readings | None:
        """Return the readouts of answers; those that depend on the contact law are NaN once the law has changed.

        The answer before them is taken into account for the loading rate.
        """
        drawing, together = self._drawing, np.concatenate((self._before, answers))
        self._before = answers[-1:].copy()
        if drawing.patch is None:
            return None
        read = drawing.patch.readouts(drawing.law, together)[len(together) - len(answers) :]
        for name in () if self._law_known else SPREAD:
            read[name] = np.nan
        return read

    def finish(self) -> None:
        """Write the last events; curves of a single answer become points."""
        if self._begun and self._alone:
            for path, names, colours, _ in self._styles():
                points = rr.SeriesPoints(names=names, colors=colours, marker_sizes=[SINGLE])
                self._recording.log(f"{self._drawing.knee}/{CURVES}/{path}", points, static=True)
        self._write_events(self._remarks.finish())
        if self._begun and not self._has_events:
            self._write_events([Remark(self._last_stamp, "no events")])

    def _begin(self, stamp: int) -> None:
        """Choose by the first stamp [ns] whether the timeline shows dates or durations; write earlier notes."""
        self._begun = True
        self._time = _dates if stamp >= DATES_FROM else _durations
        self._write_events([remark_of_note(stamp, name, values) for name, values in self._early])

    def _write_still(self) -> None:
        """Write the parts of the scene that do not change."""

        def at(root: str) -> Callable[[str, Any], None]:
            place = f"{self._drawing.knee}/{root}"
            return lambda path, what: self._recording.log(f"{place}/{path}" if path else place, what, static=True)

        at(sagittal.CAMERA)("", sagittal.camera())
        sagittal.send_still_plane(self._drawing, at(sagittal.BODY))
        sagittal.send_still_marks(frame_of(self._drawing), at(sagittal.CAMERA))
        steps = {plot.path for plot in self._plots if plot.steps}
        for path, names, colours, widths in self._styles():
            mode = rr.components.InterpolationMode.StepAfter if path in steps else None
            at(CURVES)(path, rr.SeriesLines(names=names, colors=colours, widths=widths, interpolation_mode=mode))
        names = list(NAME_OF_STATE.values())
        at(STATES)(CONTACT, rr.StateConfiguration(values=names, colors=[APART, CARTILAGE, BONE]))
        at(STATES)(LEVEL, rr.StateConfiguration(values=LEVEL_NAMES, colors=LEVEL_COLOURS))

    def _styles(self) -> Iterator[tuple[str, Sequence[str], Sequence[Colour], Sequence[float]]]:
        """Yield path, names, colours and widths of the curves of each entity."""
        for plot in self._plots:
            names, colours, widths = zip(*(series[:3] for series in plot.series), strict=True)
            if self._number is not None:
                colours = (KNEE_COLOURS[self._number % len(KNEE_COLOURS)].colour,) * len(names)
            yield plot.path, names, colours, widths
        if self._drawing.has_bone:
            yield LAYER, [LAYER_NAME], [LAYER_COLOUR], [1.5]

    def _write_changes(self, path: str, stamps: Any, values: Any, names: Sequence[str]) -> None:
        """Write a state where it changes, and again after `REPEAT` where old data is dropped."""
        states = values.astype(int)
        changes = np.flatnonzero(np.diff(states, prepend=self._states.get(path, -1)))
        self._states[path] = int(states[-1])
        if not len(changes) and abs(stamps[-1] - self._written[path]) >= self._repeat:  # stamps may go back
            changes = np.array([len(states) - 1])
        if len(changes):
            self._written[path] = int(stamps[changes[-1]])
            texts = [names[state] for state in states[changes].tolist()]
            self._send(f"{STATES}/{path}", stamps[changes], rr.StateChange.columns(state=texts))

    def _write_events(self, remarks: Sequence[Remark]) -> None:
        """Write remarks as lines of the events."""
        if remarks:
            self._has_events = True
            stamps = np.array([remark.stamp for remark in remarks], dtype=np.int64)
            texts = [f"{self._clock(remark.stamp)}  {remark.text}" for remark in remarks]
            levels = [remark.level for remark in remarks]
            self._send(EVENTS, stamps, rr.TextLog.columns(text=texts, level=levels))

    def _clock(self, stamp: int) -> str:
        """Return a stamp [ns] as text, as the timeline shows it."""
        if self._time is _dates:
            return str(np.datetime64(stamp, "ns").astype("datetime64[ms]")).replace("T", " ")
        return f"{stamp / NANOSECONDS:.3f} s"

    def _to(self, root: str, stamps: Any) -> Callable[[str, Any], None]:
        """Return a function that sends columns with these stamps to entities under `root`."""
        return lambda path, columns: self._send(f"{root}/{path}", stamps, columns)

    def _send(self, path: str, stamps: Any, columns: Any) -> None:
        """Send columns with their stamps [ns] to an entity of the knee."""
        self._recording.send_columns(f"{self._drawing.knee}/{path}", indexes=[self._time(stamps)], columns=columns)
        if self._pause:
            time.sleep(self._pause)


def _durations(stamps: Any) -> rr.TimeColumn:
    """Return stamps [ns] as durations."""
    return rr.TimeColumn(TIMELINE, duration=stamps.astype("timedelta64[ns]"))


def _dates(stamps: Any) -> rr.TimeColumn:
    """Return stamps [ns] as dates."""
    return rr.TimeColumn(TIMELINE, timestamp=stamps.astype("datetime64[ns]"))
