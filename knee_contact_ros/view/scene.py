"""The scene of one knee in a Rerun recording, written batch by batch: the knee, its curves, states and events."""

import json
import math
import time
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
import rerun as rr
from numpy.typing import NDArray
from rerun.urdf import UrdfTree

from ..model.readouts import READOUTS_OF_LAW, Readings
from ..model.types import FIRST_DATE, MM, ContactState, Rows, Status, blank_answers
from ..streams.gait_events import HEEL_STRIKE, LOAD_PEAK, NEARBY, TOE_OFF, GaitEvent, runs
from ..streams.strides import CERTAIN, Stride, Strides
from ..streams.topics import LEG_URDF, NANOSECONDS, SHANK
from ..system.files import share_folder
from . import colours, layout, plane, plots
from .anatomy import KneeOutlines
from .colours import KNEE_COLOURS, STATE_NAMES, Colour

PICTURE_PERIOD = 5_000_000
"""Time [ns] between two pictures: they are more than a screen can show"""
_LEVEL_NAMES = ("quasi-static", "first-order", "dynamic")
"""Names of the levels, by `Fidelity`"""
_LEVEL_COLOURS = [(90, 100, 120), (125, 140, 170), (165, 190, 225)]
_PHASES = {HEEL_STRIKE: "stance", TOE_OFF: "swing"}
"""Phase of the gait that an event begins"""
_NO_PHASE, _UNKNOWN = "no stride yet", "unknown"
"""Before the first of these events; where the load contradicts the phase"""
_LANDS = 400_000_000
"""Time [ns] before the end of a run in which a step may not be found yet that belongs to a load peak"""
_PHASE_COLOURS = [(105, 115, 140), (45, 50, 62), (30, 33, 40), (30, 33, 40)]
_STATES: dict[str, tuple[Sequence[str], Any]] = {
    layout.CONTACT: ([*STATE_NAMES.values()], colours.STATE_COLOURS.tolist()),
    layout.LEVEL: (_LEVEL_NAMES, _LEVEL_COLOURS),
    layout.GAIT: ([*_PHASES.values(), _NO_PHASE, _UNKNOWN], _PHASE_COLOURS),
}
"""Names and colours of the states, by their path under `KNEE/states`"""
_SINGLE_SIZE = 5.0
"""Radius of the point that replaces the curve of a single answer"""
_LAYER_DEPTH = "contact.layer_depth"
_LAW_PARAMETERS = ("contact.", "lateral.contact.")
"""Beginnings of the names of parameters on which patch, pressure and strain depend"""
_BEGINNINGS = {ContactState.SEPARATED: "lift-off", ContactState.BONE: "bone contact begins"}
"""Events by the contact state that begins; where that is the cartilage, `_ENDINGS` of the state before"""
_ENDINGS = {ContactState.SEPARATED: "touch-down", ContactState.BONE: "bone contact ends"}


class Event(NamedTuple):
    """A line of the events."""

    stamp: int
    """Stamp [ns]"""
    text: str
    level: str = "INFO"
    phase: str = ""
    """Phase of the gait that begins here; empty if none does"""


class Scene:
    """Writes a knee's answers into a Rerun recording."""

    def __init__(
        self,
        recording: rr.RecordingStream,
        drawing: KneeOutlines,
        latency: bool = False,
        pause: float = 0.0,
        forgetful: bool = False,
        among: Sequence[str] = (),
        gait_events: Sequence[GaitEvent] = (),
    ) -> None:
        """Write the parts of the scene that do not change.

        Args:
            recording: Rerun's recording.
            drawing: Outlines of the knee.
            latency: Whether the answers have latencies.
            pause: Pause [s] between two messages to Rerun.
            forgetful: Whether old data is dropped, so that states must be repeated.
            among: Names of all knees in the scene, for the colours of their curves if there are several.
            gait_events: Those that an importer read, see `GaitEvents`.
        """
        self._recording = recording
        self._drawing = drawing
        self._pause = pause
        self._forgetful = forgetful
        self._among = among
        self._plots = plots.plots_of(drawing, latency)
        self._pictures = PictureChoice()
        self._events = EventFinder(drawing.body_weight, gait_events)
        self._second_layer = drawing.second_layer
        self._law_known = True
        self._count = 0
        self._last_stamp = 0
        self._dated = False
        """Whether the timeline shows dates, and not durations"""
        self._has_events = False
        self._last_answer = blank_answers(0)
        self._last_states: dict[str, int] = {}
        self._notes: list[tuple[str, Mapping[str, str]]] = []
        """Notes that wait for the next answers"""

    def show(self, answers: Rows) -> None:
        """Write answers, at least one."""
        stamps = answers["stamp"]
        if not self._count:
            # Rerun allows one kind of time on a timeline: the first stamp decides.
            self._last_stamp = int(stamps[0])
            self._dated = self._last_stamp >= FIRST_DATE
            self._write_constants()  # not before: without a pose the femur would lie in the tibia
            self._recording.flush()  # a viewer that gets a mesh's points before its triangles complains
            self._send_states(layout.GAIT, stamps[:1], [_NO_PHASE])
        self._write_events(self._take_notes())
        self._count += len(answers)
        self._last_stamp = int(stamps[-1])
        self._write_curves(answers, self._readouts(answers))
        chosen = self._pictures.choose(stamps)
        if len(chosen):
            drawn = answers[chosen]
            for root, moving in (
                (layout.BODY, plane.moving_plane(self._drawing, drawn, self._second_layer)),
                (layout.CAMERA, plane.moving_marks(self._drawing, drawn)),
                (layout.LEG, plane.moving_leg(self._drawing, drawn)),
            ):
                for path, columns in moving:
                    self._send(f"{root}/{path}", drawn["stamp"], columns)
        for path, field in ((layout.CONTACT, "contact_state"), (layout.LEVEL, "fidelity")):
            self._write_changes(path, stamps, answers[field].astype(int))
        self._write_events(self._events.find(answers))

    def note(self, name: str, values: Mapping[str, str]) -> None:
        """Note something that happened to the node after the answers so far; it is written with the next ones."""
        if _LAYER_DEPTH in values and math.isfinite(self._second_layer):
            self._second_layer = float(values[_LAYER_DEPTH])
        self._law_known &= not any(name.startswith(_LAW_PARAMETERS) for name in values)
        self._notes.append((name, values))

    def finish(self) -> None:
        """Write the last events; curves of a single answer become points."""
        if self._count == 1:
            for path, names, tints, _ in self._styles():
                points = rr.SeriesPoints(names=names, colors=tints, marker_sizes=[_SINGLE_SIZE])
                self._log_constant(f"{layout.CURVES}/{path}", points)
        if self._count:
            self._write_events([*self._take_notes(), *self._events.finish()])
            if not self._has_events:
                self._write_events([Event(self._last_stamp, "no events")])

    def _take_notes(self) -> list[Event]:
        """Return events of the waiting notes, at the last stamp."""
        events = [_event_of_note(self._last_stamp, *note) for note in self._notes]
        self._notes = []
        return events

    def _readouts(self, answers: Rows) -> Readings | None:
        """Return the readouts of answers; those that depend on the contact law are NaN once the law has changed.

        The answer before them is taken into account for the loading rate.
        """
        together = np.concatenate((self._last_answer, answers))
        self._last_answer = answers[-1:].copy()
        patch = self._drawing.patch
        if patch is None:
            return None
        readouts = patch.readouts(self._drawing.law, together)[len(together) - len(answers) :]
        if not self._law_known:
            for name in READOUTS_OF_LAW:
                readouts[name] = np.nan
        return readouts

    def _write_constants(self) -> None:
        """Write the parts of the scene that do not change."""
        drawing = self._drawing
        step = rr.components.InterpolationMode.StepAfter
        steps = {plot.path: step for plot in self._plots if plot.steps}
        curves = [
            (
                path,
                rr.SeriesLines(
                    names=names, colors=tints, widths=widths, interpolation_mode=steps.get(path)
                ),
            )
            for path, names, tints, widths in self._styles()
        ]
        states = [
            (path, rr.StateConfiguration(values=names, colors=tints))
            for path, (names, tints) in _STATES.items()
        ]
        # A millimetre at the camera's distance is one on the screen.
        camera = rr.Pinhole(
            focal_length=plane.CAMERA_DISTANCE, principal_point=(0.0, 0.0), resolution=(1.0, 1.0)
        )
        self._log_constant(layout.CAMERA, camera)
        about = rr.TextDocument(layout.about(drawing), media_type=rr.MediaType.MARKDOWN)
        self._log_constant(layout.ABOUT, about)
        frame = rr.CoordinateFrame(f"{drawing.knee}/{SHANK}")
        self._log_constant(layout.LEG, frame)
        tree = UrdfTree.from_file_path(
            share_folder() / LEG_URDF, drawing.knee, frame_prefix=f"{drawing.knee}/"
        )
        tree.log_urdf_to_recording(self._recording)
        leg = [
            (plane.ARROW, frame),
            (plane.ARROW, rr.Arrows3D.from_fields(colors=[colours.FORCE], radii=[2e-3])),
        ]
        for root, parts in (
            (layout.BODY, plane.still_plane(drawing)),
            (layout.CAMERA, plane.still_marks(drawing)),
            (layout.CURVES, curves),
            (layout.STATES, states),
            (layout.LEG, leg),
        ):
            for path, what in parts:
                self._log_constant(f"{root}/{path}", what)

    def _styles(self) -> Iterator[tuple[str, Sequence[str], Sequence[Colour], Sequence[float]]]:
        """Yield path, names, colours and widths of the curves of each entity."""
        for plot in self._plots:
            names, tints, widths = zip(*(series[:3] for series in plot.series), strict=True)
            if len(self._among) > 1:
                number = self._among.index(self._drawing.knee)
                tints = ([*KNEE_COLOURS.values()][number % len(KNEE_COLOURS)],) * len(names)
            yield plot.path, names, tints, widths
        if self._drawing.has_bone:
            yield plots.LAYER, [plots.LAYER_NAME], [plots.LAYER_COLOUR], [1.5]

    def _write_curves(self, answers: Rows, readouts: Readings | None) -> None:
        """Write all curves; of readouts, those that are known."""
        stamps = answers["stamp"]
        weight = self._drawing.body_weight
        for plot in self._plots:
            source: Any = readouts if plot.from_readouts else answers
            values = np.stack([series.values(source, weight) for series in plot.series], axis=1)
            known = np.isfinite(values[:, 0]) | (not plot.from_readouts)
            if known.any():
                scalars = rr.Scalars.columns(scalars=values[known])
                self._send(f"{layout.CURVES}/{plot.path}", stamps[known], scalars)
        if math.isfinite(self._second_layer):
            level = rr.Scalars.columns(scalars=[MM * self._second_layer] * 2)
            self._send(f"{layout.CURVES}/{plots.LAYER}", stamps[[0, -1]], level)

    def _write_changes(self, path: str, stamps: Any, states: Any) -> None:
        """Write a state where it changes, and at the end of every batch where old data is dropped."""
        changes = np.flatnonzero(np.diff(states, prepend=self._last_states.get(path, -1)))
        self._last_states[path] = int(states[-1])
        if self._forgetful:
            changes = np.union1d(changes, len(states) - 1)
        if len(changes):
            texts = [_STATES[path][0][state] for state in states[changes].tolist()]
            self._send_states(path, stamps[changes], texts)

    def _write_events(self, events: Sequence[Event]) -> None:
        """Write events as lines of text, and the phases that begin with them."""
        if events:
            self._has_events = True
            stamps = np.array([event.stamp for event in events])
            lines = [f"{self._time_text(event.stamp)}  {event.text}" for event in events]
            levels = [event.level for event in events]
            self._send(layout.EVENTS, stamps, rr.TextLog.columns(text=lines, level=levels))
        if begins := [event for event in events if event.phase]:
            stamps = np.array([event.stamp for event in begins])
            self._send_states(layout.GAIT, stamps, [event.phase for event in begins])

    def _time_text(self, stamp: int) -> str:
        """Return a stamp [ns] as text, as the timeline shows it."""
        if self._dated:
            return str(np.datetime64(stamp, "ns").astype("datetime64[ms]")).replace("T", " ")
        return f"{stamp / NANOSECONDS:.3f} s"

    def _log_constant(self, path: str, what: Any) -> None:
        """Write what does not change to an entity of the knee."""
        self._recording.log(f"{self._drawing.knee}/{path}", what, static=True)

    def _send_states(self, path: str, stamps: Any, states: Sequence[str]) -> None:
        """Send changes of a state at stamps [ns]."""
        self._send(f"{layout.STATES}/{path}", stamps, rr.StateChange.columns(state=states))

    def _send(self, path: str, stamps: Any, columns: Any) -> None:
        """Send columns with their stamps [ns] to an entity of the knee."""
        if self._dated:
            times = rr.TimeColumn(layout.TIMELINE, timestamp=stamps.astype("datetime64[ns]"))
        else:
            times = rr.TimeColumn(layout.TIMELINE, duration=stamps.astype("timedelta64[ns]"))
        entity = f"{self._drawing.knee}/{path}"
        self._recording.send_columns(entity, indexes=[times], columns=columns)
        if self._pause:
            time.sleep(self._pause)


class PictureChoice:
    """Selects the answers that are drawn: the first of every `PICTURE_PERIOD`."""

    def __init__(self) -> None:
        self._last_period = -1

    def choose(self, stamps: NDArray[np.int64]) -> NDArray[np.intp]:
        """Return the indices of the answers that are drawn; `stamps` [ns] continue those of the previous call."""
        periods = stamps // PICTURE_PERIOD
        new = np.flatnonzero(np.diff(periods, prepend=self._last_period))
        self._last_period = int(periods[-1])
        return new


class EventFinder:
    """Finds the events in answers: contact and bone, gait with the impulse of strides, status bits.

    Answers come batch by batch; the result does not depend on the batches.
    """

    def __init__(self, body_weight: float, known: Sequence[GaitEvent] = ()) -> None:
        """Look for events relative to `body_weight` [N]; for `known` ones see `GaitEvents`."""
        self._last_state = -1
        self._last_status = 0
        self._strides = Strides(body_weight, known)
        self._last_stamp: NDArray[np.int64] = np.empty(0, np.int64)  # of the answers before
        self._unsettled = list[tuple[int, str]]()  # stamps and kinds of gait events
        self._step, self._peak = (
            "",
            0,
        )  # kind of the last step that is settled, and load peak since

    def find(self, answers: Rows) -> list[Event]:
        """Return the events that become certain with these answers, at least one, by their stamps."""
        found = [*self._contact(answers), *self._flags(answers)]
        for part, anew in runs(answers["stamp"], self._last_stamp):
            if anew:
                found += self.finish()
            new = answers[part]
            found += self._gait(self._strides.add_answers(new))
            self._last_stamp = new["stamp"][-1:].copy()
            found += self._contradictions(int(self._last_stamp[0]) - CERTAIN)
        return sorted(found)

    def finish(self) -> list[Event]:
        """Return the events that the end makes certain; later answers start again."""
        self._strides.events = []
        found = [*self._gait(self._strides.finish_strides())]
        for stamp in self._last_stamp.tolist():
            found += self._contradictions(stamp - _LANDS)
        self._unsettled, self._step, self._last_stamp = [], "", np.empty(0, np.int64)
        return sorted(found)

    def _gait(self, strides: Sequence[Stride]) -> Iterator[Event]:
        """Yield the gait events that have become certain with these strides, and the strides."""
        for event in self._strides.events:
            self._unsettled.append((event.stamp, event.kind))
            yield Event(event.stamp, event.text, phase=_PHASES.get(event.kind, ""))
        for span, _, _, impulse, stance, *_ in strides:
            text = f"stride of {span.duration:.2f} s: impulse {impulse:.1f} N s, stance {stance:.1f} N s"
            yield Event(span.end, text)

    def _contradictions(self, until: float) -> Iterator[Event]:
        """Yield where the load contradicts the phase, by the gait events up to a stamp [ns], which are all known."""
        self._unsettled.sort()
        while self._unsettled and self._unsettled[0][0] <= until:
            stamp, kind = self._unsettled.pop(0)
            if kind != LOAD_PEAK:
                if kind == self._step == HEEL_STRIKE and self._peak:
                    text = "the leg swings after this peak, but no end of stance was found"
                    yield Event(self._peak, text, phase=_UNKNOWN)
                self._step, self._peak = kind, 0
                continue
            lands = any(k == HEEL_STRIKE and at < stamp + NEARBY for at, k in self._unsettled)
            if self._step == TOE_OFF and not lands:
                self._step = ""
                text = "the leg is loaded, but no beginning of stance was found"
                yield Event(stamp, text, phase=_UNKNOWN)
            self._peak = stamp

    def _contact(self, answers: Rows) -> Iterator[Event]:
        """Yield events of changes of the contact state."""
        states = np.append(self._last_state, answers["contact_state"].astype(int))
        self._last_state = int(states[-1])
        for i in np.flatnonzero(np.diff(states)).tolist():
            # Before the very first answer there is no state that could end.
            if states[i] >= 0:
                text = _BEGINNINGS.get(states[i + 1]) or _ENDINGS[states[i]]
                yield Event(int(answers["stamp"][i]), text)

    def _flags(self, answers: Rows) -> Iterator[Event]:
        """Yield events of status bits that are newly set."""
        status = np.append(self._last_status, answers["status"].astype(int))
        self._last_status = int(status[-1])
        new_bits = status[1:] & ~status[:-1]
        for i in np.flatnonzero(new_bits).tolist():
            for bit in Status:
                if new_bits[i] & bit:
                    text = str(bit.name).lower().replace("_", " ")
                    yield Event(int(answers["stamp"][i]), text, "WARN")


def _event_of_note(stamp: int, name: str, values: Mapping[str, str]) -> Event:
    """Return the event of a note of something that happened to the node, as a reset or changed parameters."""

    def plain(value: str) -> str:
        """Return a value in JSON without quotes, and other text as it is."""
        try:
            return str(json.loads(value))
        except ValueError:
            return value

    text = ", ".join(f"{key} = {plain(value)}" for key, value in values.items() if key != "tick")
    title = name.replace("_", " ")
    return Event(stamp, f"{title}: {text}" if text else title)
