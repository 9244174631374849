"""Show answers in Rerun: the sagittal view and the curves, written in batches from a thread of its own.

In the sagittal view lengths are mm and y points up on the screen (Rerun's 2-D y points down, so y is negated here).
"""

from __future__ import annotations

import math
import queue
import threading
import time
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
import rerun as rr
import rerun.blueprint as rrb
from numpy.typing import NDArray

from knee_contact_ros.core.model import KneeModel
from knee_contact_ros.outputs import claim
from knee_contact_ros.pipeline import Answer, Ending

APPLICATION = "knee_contact_ros"
TIMELINE = "stamp"
MM = 1e3
BATCH = 100
"""Answers per message to Rerun: one costs as much as a hundred."""
BATCH_PERIOD = 0.25
"""How long [s] a batch waits to be full."""
QUEUE = 20_000
"""Answers that may wait; more are dropped and counted."""
PLATEAU_REACH = 0.04
"""How far [m] the tibial surface is drawn to both sides."""
NEWTONS_PER_MM = 50.0
"""Scale of the force arrow."""
BONE, CARTILAGE, FORCE, LOAD, POINT = (
    (225, 215, 195),
    (110, 170, 235),
    (235, 95, 80),
    (150, 150, 160),
    (250, 200, 70),
)
SERIES = {
    "flexion/angle": ("flexion angle [deg]", CARTILAGE, 2.0),
    "force/load": ("load [BW]", LOAD, 1.0),
    "force/contact": ("contact force [BW]", FORCE, 3.0),
    "depth/penetration": ("penetration depth [mm]", CARTILAGE, 2.0),
    "depth/gap": ("gap [mm]", LOAD, 1.0),
    "depth/second_layer": ("second layer begins [mm]", BONE, 1.0),
    "contact_point/anterior": ("contact point, anterior [mm]", POINT, 2.0),
}
"""Curves: name in the legend, colour and width."""


class RerunThread:
    """Writes answers to an `.rrd` file without ever holding up the caller."""

    def __init__(self, scene: RerunFile, on_failure: Callable[[str], None]) -> None:
        """Take over `scene`; `on_failure` is told once if it cannot be written."""
        self.dropped = 0
        self.failure = ""
        self._on_failure = on_failure
        self._scene = scene
        self._queue: queue.Queue[Answer | None] = queue.Queue(QUEUE)
        self._thread = threading.Thread(target=self._run, name="rerun", daemon=True)
        self._thread.start()

    def diagnostics(self) -> dict[str, str]:
        """How many answers wait to be shown, and how many were dropped."""
        return {"backlog": str(self._queue.qsize()), "dropped": str(self.dropped)}

    def put(self, answer: Answer) -> None:
        """Hand over an answer; drop it if too many wait or the file has failed."""
        if self.failure:
            return
        try:
            self._queue.put_nowait(answer)
        except queue.Full:
            self.dropped += 1

    def close(self, ending: Ending) -> None:  # noqa: ARG002  (inputs alone are not shown)
        """Show what waits and complete the file."""
        if not self.failure:
            self._queue.put(None)
        self._thread.join()

    def _run(self) -> None:
        ended = False
        try:
            while not ended:
                batch, ended = self._next_batch()
                if batch:
                    self._scene.show(batch)
            self._scene.close()
        except Exception as error:  # a viewer's failure must not become the knee's
            self.failure = f"Rerun recording {self._scene.path} stopped: {error}"
            self._on_failure(self.failure)
            while not self._queue.empty():  # so that nobody waits for room in it
                self._queue.get()

    def _next_batch(self) -> tuple[list[Answer], bool]:
        """Answers until the batch is full or has waited long enough, and whether the stream has ended."""
        batch: list[Answer] = []
        deadline = time.monotonic() + BATCH_PERIOD
        while len(batch) < BATCH:
            try:
                answer = self._queue.get(timeout=max(deadline - time.monotonic(), 0.0))
            except queue.Empty:
                break
            if answer is None:
                return batch, True
            batch.append(answer)
        return batch, False


class RerunFile:
    """An `.rrd` recording with its blueprint; it appears under its final name when it is complete."""

    def __init__(self, path: Path, model: KneeModel, body_weight: float) -> None:
        """Open the file and write what does not change; forces are shown in units of `body_weight` [N].

        Raises:
            UsageError: see `claim`.
        """
        self.path = path
        self._partial = claim(path)
        self._body_weight = body_weight
        self._layer = model.cartilage_thickness
        self._recording = rr.RecordingStream(APPLICATION)
        outline, extent = femoral_outline(model)
        self._recording.save(self._partial, default_blueprint=blueprint(extent))
        self._write_static(outline, tibial_outline(model))

    def show(self, answers: Sequence[Answer]) -> None:
        """Write a batch of answers."""
        contacts = [answer.contact for answer in answers]
        stamps = np.array([answer.stamp for answer in answers], dtype="timedelta64[ns]")
        index = [rr.TimeColumn(TIMELINE, duration=stamps)]

        def send(path: str, columns: rr.ComponentColumnList) -> None:
            self._recording.send_columns(path, indexes=index, columns=columns)

        angle = np.array([contact.flexion_angle for contact in contacts])
        force = np.array([contact.contact_force for contact in contacts])
        height = np.array([contact.femoral_height for contact in contacts])
        point = np.array([[contact.contact_point.x, contact.contact_point.y] for contact in contacts])
        curves = {
            "flexion/angle": np.degrees(angle),
            "force/load": np.array([contact.load for contact in contacts]) / self._body_weight,
            "force/contact": force / self._body_weight,
            "depth/penetration": np.array([contact.penetration_depth for contact in contacts]) * MM,
            "depth/gap": np.array([contact.gap for contact in contacts]) * MM,
            "contact_point/anterior": point[:, 0] * MM,
        }
        if math.isfinite(self._layer):
            curves["depth/second_layer"] = np.full(len(answers), self._layer * MM)
        for path, values in curves.items():
            send(f"curves/{path}", rr.Scalars.columns(scalars=values))

        zero = np.zeros(len(answers))
        half = -0.5 * angle  # the screen's y points down, so a turn changes its sign
        turn = np.stack([zero, zero, np.sin(half), np.cos(half)], axis=1)
        femoral_x = np.array([answer.femoral_x for answer in answers])
        place = np.stack([femoral_x * MM, -height * MM, zero], axis=1)
        send("sagittal/femur", rr.Transform3D.columns(translation=place, quaternion=turn))
        on_screen = point * [MM, -MM]
        normal = np.array([answer.normal for answer in answers]) * [1.0, -1.0]
        send("sagittal/contact_point", rr.Points2D.columns(positions=on_screen))
        arrows = force[:, None] / NEWTONS_PER_MM * normal
        send("sagittal/contact_force_on_femur", rr.Arrows2D.columns(origins=on_screen, vectors=arrows))

    def close(self) -> None:
        """Complete the file and give it its name."""
        self._recording.flush()
        self._recording.disconnect()
        self._partial.replace(self.path)

    def discard(self) -> None:
        """Give up: leave nothing behind."""
        self._recording.disconnect()
        self._partial.unlink(missing_ok=True)

    def _write_static(self, femur: NDArray[np.float64], tibia: NDArray[np.float64]) -> None:
        def log(path: str, *what: rr.AsComponents) -> None:
            self._recording.log(path, *what, static=True)

        for path, (name, colour, width) in SERIES.items():
            log(f"curves/{path}", rr.SeriesLines(names=name, colors=[colour], widths=[width]))
        log("sagittal/femur/surface", rr.LineStrips2D([femur * [MM, -MM]], colors=[CARTILAGE], radii=[0.35]))
        axis = [[0.0, 0.0], [0.0, -45.0]]
        log("sagittal/femur/long_axis", rr.LineStrips2D([axis], colors=[BONE], radii=[0.25]))
        log("sagittal/femur/reference_point", rr.Points2D([[0.0, 0.0]], colors=[BONE], radii=[0.8]))
        log("sagittal/tibial_plateau", rr.LineStrips2D([tibia * [MM, -MM]], colors=[BONE], radii=[0.35]))
        log("sagittal/contact_point", rr.Points2D.from_fields(colors=[POINT], radii=[0.9]))
        log("sagittal/contact_force_on_femur", rr.Arrows2D.from_fields(colors=[FORCE], radii=[0.4]))


def femoral_outline(model: KneeModel) -> tuple[NDArray[np.float64], float]:
    """Points of the femoral surface, shape (n, 2) [m] in the femur frame, and its reach [mm]."""
    outline = model.pair.femur.outline()
    return outline, float(np.hypot(*outline.T).max()) * MM


def tibial_outline(model: KneeModel) -> NDArray[np.float64]:
    """Points of the tibial surface under the femur, shape (n, 2) [m], tibia frame."""
    return model.pair.outline(PLATEAU_REACH)


def blueprint(extent: float) -> rrb.Blueprint:
    """Views: the sagittal plane on the left, the curves on the right with one common time axis."""
    width = 1.5 * extent
    sagittal = rrb.Spatial2DView(
        origin="sagittal",
        name="Sagittal plane [mm], anterior to the right; arrow 50 N per mm",
        visual_bounds=rrb.VisualBounds2D(x_range=[-width, width], y_range=[-2.7 * extent, 0.5 * extent]),
    )

    def curves(group: str, name: str, legend: bool = False) -> rrb.TimeSeriesView:
        return rrb.TimeSeriesView(
            origin=f"curves/{group}",
            name=name,
            axis_x=rrb.TimeAxis(link=rrb.components.LinkAxis.LinkToGlobal),
            plot_legend=rrb.PlotLegend(corner=rrb.Corner2D.RightBottom, visible=legend),
        )

    return rrb.Blueprint(
        rrb.Horizontal(
            sagittal,
            rrb.Vertical(
                curves("flexion", "Flexion angle [deg]"),
                curves("force", "Compartment force [BW]", legend=True),
                curves("depth", "Penetration depth [mm]", legend=True),
                curves("contact_point", "Contact point on the plateau [mm]"),
            ),
            column_shares=[2, 3],
        ),
        rrb.TimePanel(timeline=TIMELINE, state="collapsed"),
        rrb.BlueprintPanel(state="collapsed"),
        rrb.SelectionPanel(state="collapsed"),
    )
