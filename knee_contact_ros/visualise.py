"""Show answers in Rerun: the sagittal view and the curves, written in batches.

In the sagittal view lengths are mm and y points up on the screen (Rerun's 2-D y points down, so y is negated here).
"""

from __future__ import annotations

import math
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import rerun as rr
import rerun.blueprint as rrb
from numpy.typing import NDArray

from knee_contact_ros.answer import Ending
from knee_contact_ros.drawing import Drawing, Shown
from knee_contact_ros.outputs import claim

APPLICATION = "knee_contact_ros"
TIMELINE = "stamp"
MM = 1e3
BATCH = 1000
"""Answers per message to Rerun at most: one costs as much as a hundred."""
BATCH_PERIOD = 0.5
"""How long [s] a batch waits to be full."""
PAUSE = 0.0005
"""[s] between two messages to Rerun beside a node: the longest time that it may find a processor taken is one's"""
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


class RerunFile:
    """An `.rrd` recording with its blueprint; it appears under its final name when it is complete."""

    def __init__(self, path: Path, drawing: Drawing, pause: float = 0.0) -> None:
        """Open the file and write what does not change; rest for `pause` [s] between two messages to Rerun.

        Raises:
            UsageError: see `claim`.
        """
        self.path = path
        self._partial = claim(path)
        self._body_weight = drawing.body_weight
        self._layer = drawing.second_layer
        self._pause = pause
        self._recording = rr.RecordingStream(APPLICATION)
        extent = float(np.hypot(*drawing.femur.T).max()) * MM
        self._recording.save(self._partial, default_blueprint=blueprint(extent))
        self._write_static(drawing.femur, drawing.tibia)

    def show(self, ticks: Sequence[Shown]) -> None:
        """Write a batch."""
        stamps = np.array([tick.stamp for tick in ticks], dtype="timedelta64[ns]")
        index = [rr.TimeColumn(TIMELINE, duration=stamps)]

        def send(path: str, columns: rr.ComponentColumnList) -> None:
            self._recording.send_columns(path, indexes=index, columns=columns)
            if self._pause:
                time.sleep(self._pause)

        angle = np.array([tick.flexion_angle for tick in ticks])
        force = np.array([tick.contact_force for tick in ticks])
        height = np.array([tick.femoral_height for tick in ticks])
        point = np.array([[tick.point_x, tick.point_y] for tick in ticks])
        curves = {
            "flexion/angle": np.degrees(angle),
            "force/load": np.array([tick.load for tick in ticks]) / self._body_weight,
            "force/contact": force / self._body_weight,
            "depth/penetration": np.array([tick.penetration_depth for tick in ticks]) * MM,
            "depth/gap": np.array([tick.gap for tick in ticks]) * MM,
            "contact_point/anterior": point[:, 0] * MM,
        }
        if math.isfinite(self._layer):
            curves["depth/second_layer"] = np.full(len(ticks), self._layer * MM)
        for path, values in curves.items():
            send(f"curves/{path}", rr.Scalars.columns(scalars=values))

        zero = np.zeros(len(ticks))
        half = -0.5 * angle  # the screen's y points down, so a turn changes its sign
        turn = np.stack([zero, zero, np.sin(half), np.cos(half)], axis=1)
        femoral_x = np.array([tick.femoral_x for tick in ticks])
        place = np.stack([femoral_x * MM, -height * MM, zero], axis=1)
        send("sagittal/femur", rr.Transform3D.columns(translation=place, quaternion=turn))
        on_screen = point * [MM, -MM]
        normal = np.array([[tick.normal_x, tick.normal_y] for tick in ticks]) * [1.0, -1.0]
        send("sagittal/contact_point", rr.Points2D.columns(positions=on_screen))
        arrows = force[:, None] / NEWTONS_PER_MM * normal
        send("sagittal/contact_force_on_femur", rr.Arrows2D.columns(origins=on_screen, vectors=arrows))

    def flush(self) -> None:
        """Hand all that was shown to the operating system; only this tells that a disk is full."""
        self._recording.flush()

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


class Viewer:
    """A Rerun file as a sink's process writes it (`apart_child.Output`)."""

    period = BATCH_PERIOD
    remarks: tuple[str, ...] = ()

    def __init__(self, scene: RerunFile) -> None:
        self._scene = scene
        self._batch: list[Shown] = []

    def write(self, row: tuple[Any, ...]) -> None:
        """Show what `shown_row` gives."""
        self._batch.append(Shown(*row))
        if len(self._batch) == BATCH:
            self._show()

    def note(self, name: str, values: dict[str, str]) -> None:
        """Notes are not shown."""

    def flush(self) -> None:
        """Show what waits."""
        if self._batch:
            self._show()
        self._scene.flush()

    def must_end(self) -> str:
        """Only a full disk ends it, and `flush` tells that."""
        return ""

    def finish(self, ending: Ending | None) -> None:  # noqa: ARG002  (inputs alone are not shown)
        """Show what waits and complete the file."""
        self.flush()
        self._scene.close()

    def discard(self) -> None:
        """Leave no file behind."""
        self._scene.discard()

    def _show(self) -> None:
        self._scene.show(self._batch)
        self._batch = []


def open_output(path: Path, drawing: Drawing) -> Viewer:
    """Open a Rerun file for a sink's process.

    Raises:
        UsageError: see `claim`.
    """
    return Viewer(RerunFile(path, drawing, PAUSE))


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
