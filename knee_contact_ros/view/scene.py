"""The scene of one knee in a Rerun recording, written batch by batch: sagittal plane, curves, states and events.

Rerun fills triangles in space, but not polygons in a plane. So the knee is in space, upright in front of a camera whose
distance and focal length make a millimetre of the knee one on the screen. A plane's view through that camera can be
moved and magnified, but not rotated. Layers in front are slightly nearer to the camera. On the screen y points down, so
y is negated here.
"""

from __future__ import annotations

import json
import math
import time
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
import rerun as rr
from numpy.typing import NDArray
from rerun.urdf import UrdfTree

from knee_contact_ros.model.readouts import SPREAD, Readings
from knee_contact_ros.model.types import MM, ContactState, Floats, Rows, Status, blank_answers
from knee_contact_ros.results import DATES_FROM
from knee_contact_ros.streams.gait_events import HEEL_STRIKE, TOE_OFF
from knee_contact_ros.streams.strides import Stride, Strides
from knee_contact_ros.streams.topics import LEG_URDF, NANOSECONDS, SHANK, THIGH
from knee_contact_ros.system.files import share_folder
from knee_contact_ros.view import colours, layout
from knee_contact_ros.view.anatomy import (
    NEWTONS_PER_MM,
    OVERLAP_POINTS,
    KneeOutlines,
    find_overlaps,
    signed_areas,
    to_tibia_frame,
)
from knee_contact_ros.view.colours import KNEE_COLOURS, STATE_NAMES, Colour
from knee_contact_ros.view.layout import MAGNIFICATION, SCALE_BAR

ON_SCREEN = np.array([MM, -MM])
"""Factors from m in the tibia frame to mm on the screen"""
PICTURE_PERIOD = 5_000_000
"""Time [ns] between two pictures: they are more than a screen can show"""
DISTANCE, LAYER_DISTANCE = 1000.0, 0.2
"""Distance of the camera from the knee [mm], and distance between two layers [mm]"""
LAYERS = ("tibia", "tibial cartilage", "femur", "femoral cartilage", "edge", "overlap")
"""Names of the layers, from back to front"""
THIN, LINE, WIDE, POINT_SIZE, PATH_SIZE = -0.6, -1.0, -2.2, -4.5, -1.4
"""Half-widths on the screen at any magnification; Rerun takes them as negative numbers"""
ON_TOP, ABOVE = 40.0, 35.0
"""Draw orders of marks; that of other points is 30"""
UNSEEN = -0.01
"""Half-width of a point of which only the label is visible"""
ABOVE_AXIS, ABOVE_FORCE = 9.0, 13.0
"""Distances [mm] from the tip of an arrow to its word above, of one line and of two"""
BELOW, BELOW_FORCE = 1.0, 7.0
"""Distances [mm] from the overlap to the depth's word below it, and from the contact point past the force's word"""
FORCE_WITHIN = 0.8
"""Largest distance from the contact to the force's word, in extents of the femur: there is bone behind it"""
FEMUR, POINT, OVERLAP, ARROW, FORCE_NAME, DEPTH = (
    "femur",
    "contact_point",
    "overlap",
    "contact_force_on_femur",
    "contact_force",
    "depth",
)
LEVEL_NAMES = ("quasi-static", "first-order", "dynamic")
"""Names of the levels, by `Fidelity`"""
LEVEL_COLOURS = [(90, 100, 120), (125, 140, 170), (165, 190, 225)]
PHASES = {HEEL_STRIKE: "stance", TOE_OFF: "swing"}
"""Phase of the gait that an event begins"""
NO_PHASE = "no stride yet"
"""Before the first of these events"""
PHASE_COLOURS = [(105, 115, 140), (45, 50, 62), (30, 33, 40)]
STATES: dict[str, tuple[Sequence[str], Any]] = {
    layout.CONTACT: ([*STATE_NAMES.values()], colours.STATE_COLOURS.tolist()),
    layout.LEVEL: (LEVEL_NAMES, LEVEL_COLOURS),
    layout.GAIT: ([*PHASES.values(), NO_PHASE], PHASE_COLOURS),
}
"""Names and colours of the states, by their path under `KNEE/states`"""
LEG_SCALE = 1e-4
"""Length of the force's arrow in space by the force [m/N]"""
SINGLE = 5.0
"""Radius of the point that replaces the curve of a single answer"""
LAYER_DEPTH = "contact.layer_depth"
LAW = ("contact.", "lateral.contact.")
"""Beginnings of the names of parameters on which patch, pressure and strain depend"""
BEGUN = {ContactState.SEPARATED: "lift-off", ContactState.BONE: "bone contact begins"}
"""Events by the contact state that begins, and, for contact of the cartilage, by the state before"""
BEGUN_FROM = {ContactState.SEPARATED: "touch-down", ContactState.BONE: "bone contact ends"}
Triangles = NDArray[np.uint32]
"""Triangles as indices of their corners, shape (m, 3)"""


class Remark(NamedTuple):
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
    ) -> None:
        """Write the parts of the scene that do not change.

        Args:
            recording: Rerun's recording.
            drawing: Outlines of the knee.
            latency: Whether the answers have latencies.
            pause: Pause [s] between two messages to Rerun.
            forgetful: Whether old data is dropped, so that states must be repeated.
            among: Names of all knees in the scene, for the colours of their curves if there are several.
        """
        self._recording, self._drawing, self._pause, self._forgetful = (
            recording,
            drawing,
            pause,
            forgetful,
        )
        self._plots, self._among = layout.plots_of(drawing, latency), among
        self._layer, self._law_known = drawing.second_layer, True
        self._pictures, self._remarks = PictureChoice(), Remarks(drawing.body_weight)
        self._count, self._last_stamp, self._dated, self._has_events = 0, 0, False, False
        self._before, self._states = blank_answers(0), dict[str, int]()
        self._notes: list[tuple[str, Mapping[str, str]]] = []
        """Notes that wait for the next answers"""
        self._write_still()

    def show(self, answers: Rows) -> None:
        """Write answers, at least one."""
        stamps = answers["stamp"]
        if (
            not self._count
        ):  # the first stamp decides whether the timeline shows dates or durations
            self._last_stamp, self._dated = int(stamps[0]), bool(stamps[0] >= DATES_FROM)
            self._send(
                f"{layout.STATES}/{layout.GAIT}",
                stamps[:1],
                rr.StateChange.columns(state=[NO_PHASE]),
            )
        self._write_events(self._noted())
        self._count, self._last_stamp = self._count + len(answers), int(stamps[-1])
        self._write_curves(answers, self._read_off(answers))
        chosen = self._pictures.choose(stamps)
        if len(chosen):
            drawn = answers[chosen]
            for root, moving in (
                (layout.BODY, moving_plane(self._drawing, drawn, self._layer)),
                (layout.CAMERA, moving_marks(self._drawing, drawn)),
                (layout.LEG, moving_leg(self._drawing, drawn)),
            ):
                for path, columns in moving:
                    self._send(f"{root}/{path}", drawn["stamp"], columns)
        for path, field in ((layout.CONTACT, "contact_state"), (layout.LEVEL, "fidelity")):
            self._write_changes(path, stamps, answers[field].astype(int))
        self._write_events(self._remarks.take(answers))

    def note(self, name: str, values: Mapping[str, str]) -> None:
        """Note something that happened to the node after the answers so far; it is written with the next ones."""
        if LAYER_DEPTH in values and math.isfinite(self._layer):
            self._layer = float(values[LAYER_DEPTH])
        self._law_known &= not any(name.startswith(LAW) for name in values)
        self._notes.append((name, values))

    def finish(self) -> None:
        """Write the last events; curves of a single answer become points."""
        if self._count == 1:
            for path, names, tints, _ in self._styles():
                self._keep(
                    f"{layout.CURVES}/{path}",
                    rr.SeriesPoints(names=names, colors=tints, marker_sizes=[SINGLE]),
                )
        if self._count:
            self._write_events([*self._noted(), *self._remarks.finish()])
            if not self._has_events:
                self._write_events([Remark(self._last_stamp, "no events")])

    def _noted(self) -> list[Remark]:
        """Return remarks on the waiting notes, at the last stamp."""
        notes, self._notes = self._notes, []
        return [remark_of_note(self._last_stamp, name, values) for name, values in notes]

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

    def _write_still(self) -> None:
        """Write the parts of the scene that do not change."""
        drawing, steps = self._drawing, {plot.path for plot in self._plots if plot.steps}
        step = rr.components.InterpolationMode.StepAfter
        curves = [
            (
                path,
                rr.SeriesLines(
                    names=names,
                    colors=tints,
                    widths=widths,
                    interpolation_mode=step if path in steps else None,
                ),
            )
            for path, names, tints, widths in self._styles()
        ]
        states = [
            (path, rr.StateConfiguration(values=names, colors=tints))
            for path, (names, tints) in STATES.items()
        ]
        # A millimetre at the camera's distance is one on the screen.
        camera = rr.Pinhole(
            focal_length=DISTANCE, principal_point=(0.0, 0.0), resolution=(1.0, 1.0)
        )
        self._keep(layout.CAMERA, camera)
        self._keep(
            layout.ABOUT, rr.TextDocument(layout.about(drawing), media_type=rr.MediaType.MARKDOWN)
        )
        frame = rr.CoordinateFrame(f"{drawing.knee}/{SHANK}")
        self._keep(layout.LEG, frame)
        tree = UrdfTree.from_file_path(
            share_folder() / LEG_URDF, drawing.knee, frame_prefix=f"{drawing.knee}/"
        )
        tree.log_urdf_to_recording(self._recording)
        leg = [
            (ARROW, frame),
            (ARROW, rr.Arrows3D.from_fields(colors=[colours.FORCE], radii=[2e-3])),
        ]
        for root, parts in (
            (layout.BODY, still_plane(drawing)),
            (layout.CAMERA, still_marks(drawing)),
            (layout.CURVES, curves),
            (layout.STATES, states),
            (layout.LEG, leg),
        ):
            for path, what in parts:
                self._keep(f"{root}/{path}", what)

    def _styles(self) -> Iterator[tuple[str, Sequence[str], Sequence[Colour], Sequence[float]]]:
        """Yield path, names, colours and widths of the curves of each entity."""
        for plot in self._plots:
            names, tints, widths = zip(*(series[:3] for series in plot.series), strict=True)
            if len(self._among) > 1:
                number = self._among.index(self._drawing.knee)
                tints = ([*KNEE_COLOURS.values()][number % len(KNEE_COLOURS)],) * len(names)
            yield plot.path, names, tints, widths
        if self._drawing.has_bone:
            yield layout.LAYER, [layout.LAYER_NAME], [layout.LAYER_COLOUR], [1.5]

    def _write_curves(self, answers: Rows, read: Readings | None) -> None:
        """Write all curves; of readouts, those that are known."""
        stamps = answers["stamp"]
        for plot in self._plots:
            source: Any = read if plot.read_off else answers
            values = np.stack(
                [series.values(source, self._drawing.body_weight) for series in plot.series],
                axis=1,
            )
            known = np.isfinite(values[:, 0]) | (not plot.read_off)
            if known.any():
                self._send(
                    f"{layout.CURVES}/{plot.path}",
                    stamps[known],
                    rr.Scalars.columns(scalars=values[known]),
                )
        if math.isfinite(self._layer):
            level = rr.Scalars.columns(scalars=[MM * self._layer] * 2)
            self._send(f"{layout.CURVES}/{layout.LAYER}", stamps[[0, -1]], level)

    def _write_changes(self, path: str, stamps: Any, states: Any) -> None:
        """Write a state where it changes, and at the end of every batch where old data is dropped."""
        changes = np.flatnonzero(np.diff(states, prepend=self._states.get(path, -1)))
        self._states[path] = int(states[-1])
        if self._forgetful:
            changes = np.union1d(changes, len(states) - 1)
        if len(changes):
            texts = [STATES[path][0][state] for state in states[changes].tolist()]
            self._send(
                f"{layout.STATES}/{path}", stamps[changes], rr.StateChange.columns(state=texts)
            )

    def _write_events(self, remarks: Sequence[Remark]) -> None:
        """Write remarks as lines of the events."""
        if remarks:
            self._has_events = True
            stamps, texts, levels, _ = zip(*remarks, strict=True)
            lines = [
                f"{self._clock(stamp)}  {text}" for stamp, text in zip(stamps, texts, strict=True)
            ]
            self._send(
                layout.EVENTS, np.array(stamps), rr.TextLog.columns(text=lines, level=levels)
            )
        if begun := [(remark.stamp, remark.phase) for remark in remarks if remark.phase]:
            stamps, phases = zip(*begun, strict=True)
            self._send(
                f"{layout.STATES}/{layout.GAIT}",
                np.array(stamps),
                rr.StateChange.columns(state=phases),
            )

    def _clock(self, stamp: int) -> str:
        """Return a stamp [ns] as text, as the timeline shows it."""
        if self._dated:
            return str(np.datetime64(stamp, "ns").astype("datetime64[ms]")).replace("T", " ")
        return f"{stamp / NANOSECONDS:.3f} s"

    def _keep(self, path: str, what: Any) -> None:
        """Write what does not change to an entity of the knee."""
        self._recording.log(f"{self._drawing.knee}/{path}", what, static=True)

    def _send(self, path: str, stamps: Any, columns: Any) -> None:
        """Send columns with their stamps [ns] to an entity of the knee."""
        name, kind = (
            ("timestamp", "datetime64[ns]") if self._dated else ("duration", "timedelta64[ns]")
        )
        times = rr.TimeColumn(layout.TIMELINE, **{name: stamps.astype(kind)})
        self._recording.send_columns(
            f"{self._drawing.knee}/{path}", indexes=[times], columns=columns
        )
        if self._pause:
            time.sleep(self._pause)


class PictureChoice:
    """Selects the answers that are drawn: the first of every `PICTURE_PERIOD`."""

    def __init__(self) -> None:
        self._period = -1  # of the last picture

    def choose(self, stamps: NDArray[np.int64]) -> NDArray[np.intp]:
        """Return the indices of the answers that are drawn; `stamps` [ns] continue those of the previous call."""
        periods = stamps // PICTURE_PERIOD
        new = np.flatnonzero(np.diff(periods, prepend=self._period))
        self._period = int(periods[-1])
        return new


def still_plane(drawing: KneeOutlines) -> Iterator[tuple[str, Any]]:
    """Yield paths and data of the polygons, and of the parts of the overlap that do not change."""
    knee = drawing.anatomy
    for name, layer, bone, cover, colour in (
        ("tibia", "tibial cartilage", knee.tibia_bone, knee.tibia_cartilage, colours.TIBIA),
        (FEMUR, "femoral cartilage", knee.femur_bone, knee.femur_cartilage, colours.FEMUR),
    ):
        for path, polygon, place, paint in (
            ("bone", bone, name, colour),
            ("cartilage", cover, layer, colours.COVER),
        ):
            vertices, corners = _in_space(polygon * ON_SCREEN, place), triangles_of(polygon)
            yield (
                f"{name}/{path}",
                rr.Mesh3D(
                    vertex_positions=vertices, triangle_indices=corners, albedo_factor=paint
                ),
            )
        edges = [
            _in_space(ON_SCREEN * np.concatenate([shape, shape[:1]]), "edge")
            for shape in (bone, cover)
        ]
        yield (
            f"{name}/edges",
            rr.LineStrips3D(edges, colors=[colours.EDGE, colours.COVER], radii=[THIN]),
        )
    paints = [colours.CARTILAGE, colours.CARTILAGE, *([colours.BONE] if drawing.has_bone else [])]
    near = np.arange(OVERLAP_POINTS - 1)[
        :, None
    ]  # a band between two rows of points, which follow each other
    band = np.concatenate(
        [
            near + np.array([0, 1, OVERLAP_POINTS]),
            near + np.array([OVERLAP_POINTS, 1, OVERLAP_POINTS + 1]),
        ]
    )
    indices = np.concatenate(
        [band + 2 * OVERLAP_POINTS * number for number in range(len(paints))]
    ).astype(np.uint32)
    tints = np.array(paints, dtype=np.uint8).repeat(2 * OVERLAP_POINTS, axis=0)
    yield OVERLAP, rr.Mesh3D.from_fields(triangle_indices=indices, vertex_colors=tints)


def still_marks(drawing: KneeOutlines) -> Iterator[tuple[str, Any]]:
    """Yield paths and data of the marks in front of the knee, as far as they do not change."""

    def word(
        place: Any, text: str, colour: Colour = colours.TEXT
    ) -> rr.Points2D:  # below a place on the screen [mm]
        return rr.Points2D(
            [place], labels=[text], colors=[colour], radii=[UNSEEN], show_labels=True
        )

    frame = layout.frame_of(drawing)
    corner, length = np.array(frame.axes), frame.axis_length
    ends = np.array([[length, 0.0], [0.0, -length]])
    yield (
        "axes",
        rr.Arrows2D(origins=[corner, corner], vectors=ends, colors=[colours.TEXT], radii=[LINE]),
    )
    yield "axes/anterior", word(corner + 1.1 * ends[0], "anterior")
    yield "axes/superior", word(corner + ends[1] - [0.0, ABOVE_AXIS], "superior")
    bar = np.array([frame.scale, frame.scale]) + np.array([[0.0, 0.0], [SCALE_BAR, 0.0]])
    yield "scale", rr.LineStrips2D([bar], colors=[colours.TEXT], radii=[WIDE])
    yield "scale/name", word(bar.mean(axis=0), f"{SCALE_BAR:g} mm")
    yield "tibia/name", word(frame.tibia_name, "tibia", colours.INK)
    yield f"{FEMUR}/name", word(frame.femur_name, "femur", colours.INK)
    yield POINT, rr.Points2D.from_fields(radii=[POINT_SIZE], draw_order=ON_TOP)
    yield (
        layout.PATH,
        rr.Points2D.from_fields(
            colors=[colours.CONTACT_PATH], radii=[PATH_SIZE], draw_order=ABOVE
        ),
    )
    yield ARROW, rr.Arrows2D.from_fields(colors=[colours.FORCE], radii=[WIDE])
    yield (
        FORCE_NAME,
        rr.Points2D.from_fields(colors=[colours.INK], radii=[UNSEEN], show_labels=True),
    )
    yield DEPTH, rr.Points2D.from_fields(colors=[colours.INK], radii=[UNSEEN], show_labels=True)


def moving_plane(drawing: KneeOutlines, answers: Rows, layer: float) -> Iterator[tuple[str, Any]]:
    """Yield paths and columns of poses and overlaps, at least one; the second layer begins at the depth `layer` [m]."""
    yield FEMUR, _pose(answers)
    femur = to_tibia_frame(
        drawing.femur, answers["flexion_angle"], answers["femoral_x"], answers["femoral_height"]
    )
    rows = [*find_overlaps(femur, drawing.tibia, answers["contact_point"]["x"])]
    normal = np.stack([answers["normal_x"], answers["normal_y"]], axis=1)
    depth = (rows[0] - rows[1])[..., 1] * normal[:, None, 1]
    # As it is, and its layers with their depth magnified; each along the tibia and along the femur.
    ends = [0.0 * depth, *([np.minimum(depth, layer)] * 2 if drawing.has_bone else []), depth]
    rows += [rows[0] - MAGNIFICATION * end[..., None] * normal[:, None] for end in ends]
    vertices = _in_space((np.stack(rows, axis=1) * ON_SCREEN).reshape(-1, 2), "overlap")
    yield (
        OVERLAP,
        rr.Mesh3D.columns(vertex_positions=vertices).partition(
            np.full(len(answers), len(rows) * OVERLAP_POINTS)
        ),
    )


def moving_marks(drawing: KneeOutlines, answers: Rows) -> Iterator[tuple[str, Any]]:
    """Yield paths and columns of the marks in front of the knee, of at least one picture."""
    yield FEMUR, _pose(answers)
    point = (
        np.stack([answers["contact_point"]["x"], answers["contact_point"]["y"]], axis=1)
        * ON_SCREEN
    )
    tints = colours.STATE_COLOURS[answers["contact_state"].astype(int)]
    yield POINT, rr.Points2D.columns(positions=point, colors=tints)
    yield layout.PATH, rr.Points2D.columns(positions=point)
    force = answers["contact_force"]
    arrow = (
        force[:, None]
        / NEWTONS_PER_MM
        * np.stack([answers["normal_x"], -answers["normal_y"]], axis=1)
    )
    yield ARROW, rr.Arrows2D.columns(origins=point, vectors=arrow)
    weight = drawing.body_weight
    labels = [
        f"{newtons:.0f} N\n{newtons / weight:.2f} BW" if newtons else "0 N"
        for newtons in force.tolist()
    ]
    farthest = FORCE_WITHIN * MM * float(np.ptp(drawing.femur[:, 0]))
    place = (
        point + np.minimum(1.0, farthest / np.maximum(np.hypot(*arrow.T), 1e-9))[:, None] * arrow
    )
    # Apart, the word stands on the tibia: there may be no bone above it.
    place[~(answers["gap"] > 0.0), 1] -= ABOVE_FORCE
    yield FORCE_NAME, rr.Points2D.columns(positions=place, labels=labels)
    depths, gaps = (MM * answers[name] for name in ("penetration_depth", "gap"))
    below = point.copy()
    below[:, 1] += np.where(depths > 0.0, MAGNIFICATION * depths + BELOW, BELOW_FORCE)
    labels = [
        f"{gap:.2f} mm apart"
        if depth <= 0.0
        else f"{depth:.2f} mm deep\ndrawn × {MAGNIFICATION:g}"
        for depth, gap in zip(depths.tolist(), gaps.tolist(), strict=True)
    ]
    yield DEPTH, rr.Points2D.columns(positions=below, labels=labels)


def moving_leg(drawing: KneeOutlines, answers: Rows) -> Iterator[tuple[str, Any]]:
    """Yield paths and columns of the leg in space [m], tibia frame: where the thigh is, and the force on the femur."""
    zero, half = np.zeros(len(answers)), 0.5 * answers["flexion_angle"]
    yield (
        "thigh",
        rr.Transform3D.columns(
            translation=np.stack([answers["femoral_x"], answers["femoral_height"], zero], axis=1),
            quaternion=np.stack([zero, zero, np.sin(half), np.cos(half)], axis=1),
            parent_frame=[f"{drawing.knee}/{SHANK}"] * len(answers),
            child_frame=[f"{drawing.knee}/{THIGH}"] * len(answers),
        ),
    )
    point = np.stack([answers["contact_point"][axis] for axis in "xyz"], axis=1)
    normal = np.stack([answers["normal_x"], answers["normal_y"], zero], axis=1)
    yield (
        ARROW,
        rr.Arrows3D.columns(
            origins=point, vectors=LEG_SCALE * answers["contact_force"][:, None] * normal
        ),
    )


def _pose(answers: Rows) -> Any:
    """Return the poses of the femur as a column of transforms."""
    zero = np.zeros(len(answers))
    half = (
        -0.5 * answers["flexion_angle"]
    )  # the screen's y points down, so a turn changes its sign
    turn = np.stack([zero, zero, np.sin(half), np.cos(half)], axis=1)
    place = np.stack([MM * answers["femoral_x"], -MM * answers["femoral_height"], zero], axis=1)
    return rr.Transform3D.columns(translation=place, quaternion=turn)


def _in_space(points: Floats, layer: str) -> NDArray[np.float32]:
    """Return points of the screen, shape (n, 2) [mm], in space before the camera, shape (n, 3) [mm]."""
    distance = np.full((len(points), 1), DISTANCE - LAYER_DISTANCE * LAYERS.index(layer))
    return np.concatenate([points, distance], axis=1).astype(np.float32)


def triangles_of(polygon: Floats) -> Triangles:
    """Triangulate a simple polygon, shape (n, 2), of either orientation, by cutting off ears: n - 2 triangles.

    Ears that are not next to each other are cut off together.
    """
    left = np.arange(len(polygon))[:: 1 if signed_areas(polygon).sum() > 0.0 else -1]
    triangles = []
    while len(left) > 3:
        corners = np.stack([np.roll(left, 1), left, np.roll(left, -1)])
        a, b, c = polygon[corners][:, :, None]
        others = polygon[left]
        inside = (
            (_turn(a, b, others) >= 0.0)
            & (_turn(b, c, others) >= 0.0)
            & (_turn(c, a, others) >= 0.0)
        )
        ears = (_turn(a, b, c)[:, 0] > 0.0) & (
            inside.sum(axis=1) == 3
        )  # no other corner than its own is inside
        first = int(ears.argmax())  # where there is none, by rounding alone, any
        cut = [first, *(first + 2 + np.flatnonzero(ears[first + 2 : -1 : 2]) * 2)][: len(left) - 3]
        triangles += [*corners[:, cut].T]
        left = np.delete(left, cut)
    return np.array([*triangles, left], dtype=np.uint32)


def _turn(a: Floats, b: Floats, c: Floats) -> Floats:
    """Return twice the area of triangles, positive if their corners go counterclockwise."""
    (x, y), (other_x, other_y) = np.moveaxis(b - a, -1, 0), np.moveaxis(c - a, -1, 0)
    return np.asarray(x * other_y - y * other_x)


class Remarks:
    """Finds the events in answers: contact and bone, gait with the impulse of strides, status bits.

    Answers come batch by batch; the result does not depend on the batches.
    """

    def __init__(self, body_weight: float) -> None:
        """Look for events relative to `body_weight` [N]."""
        self._state, self._status = -1, 0
        self._strides = Strides(body_weight)

    def take(self, answers: Rows) -> list[Remark]:
        """Return the remarks that become certain with these answers, at least one, by their stamps."""
        return sorted(
            [
                *self._contact(answers),
                *self._flags(answers),
                *self._gait(self._strides.add(answers)),
            ]
        )

    def finish(self) -> list[Remark]:
        """Return the remarks that the end makes certain; later answers start again."""
        self._strides.events = []
        return sorted(self._gait(self._strides.finish()))

    def _gait(self, strides: Sequence[Stride]) -> Iterator[Remark]:
        """Yield remarks on strides, and on the events that have become certain with them."""
        for event in self._strides.events:
            yield Remark(event.stamp, event.text, phase=PHASES.get(event.kind, ""))
        for span, _, _, impulse, stance, *_ in strides:
            text = f"stride of {span.duration:.2f} s: impulse {impulse:.1f} N s, stance {stance:.1f} N s"
            yield Remark(span.end, text)

    def _contact(self, answers: Rows) -> Iterator[Remark]:
        """Yield remarks on changes of the contact state."""
        states = np.append(self._state, answers["contact_state"].astype(int))
        self._state = int(states[-1])
        for i in np.flatnonzero(np.diff(states)).tolist():
            if (before := states[i]) >= 0:
                text = BEGUN.get(states[i + 1]) or BEGUN_FROM[before]
                yield Remark(int(answers["stamp"][i]), text)

    def _flags(self, answers: Rows) -> Iterator[Remark]:
        """Yield remarks on status bits that are newly set."""
        status = np.append(self._status, answers["status"].astype(int))
        self._status = int(status[-1])
        begun = status[1:] & ~status[:-1]
        for i in np.flatnonzero(begun).tolist():
            for bit in Status:
                if begun[i] & bit:
                    yield Remark(
                        int(answers["stamp"][i]), str(bit.name).lower().replace("_", " "), "WARN"
                    )


def remark_of_note(stamp: int, name: str, values: Mapping[str, str]) -> Remark:
    """Return the remark on a note of something that happened to the node, as a reset or changed parameters."""

    def plain(value: str) -> str:  # a value in JSON without quotes; other text as it is
        try:
            return str(json.loads(value))
        except ValueError:
            return value

    text = ", ".join(f"{key} = {plain(value)}" for key, value in values.items() if key != "tick")
    return Remark(stamp, name.replace("_", " ") + (f": {text}" if text else ""))
