"""The picture of a fit: every circle is seen, and what is drawn is what was fitted."""

from __future__ import annotations

import io
from pathlib import Path

import numpy as np
import pytest

from knee_contact_ros.lab.profiles import draw_circles, draw_curvature, picture
from knee_contact_ros.lab.profiles.fit import Fit, fit
from knee_contact_ros.lab.profiles.surfaces import Surface
from tests.lab.profiles.meshes import MIDDLE, TWO_RADII, femoral_curve, swept, tibial_curve

pytest.importorskip("pyvista", reason="needs the extra mesh")
pytest.importorskip("trimesh")
pytest.importorskip("matplotlib")


@pytest.fixture(scope="module", params=["femur", "tibia"])
def found(request: pytest.FixtureRequest) -> Fit:
    if request.param == "femur":
        mesh, bone = (swept(femoral_curve(TWO_RADII), inwards=depth) for depth in (0.0, 2.5e-3))
    else:
        mesh, bone = (swept(tibial_curve(), inwards=depth) for depth in (0.0, 2.0e-3))
    path = Path("made.stl")
    return fit(Surface(path, *mesh), MIDDLE, femur=request.param == "femur", bone=Surface(path, *bone))


def test_circles_are_drawn_by_how_far_the_profile_is_off(found: Fit) -> None:
    from matplotlib.figure import Figure

    axis, curvature = Figure().subplots(2, 1)
    draw_circles(axis, found)
    draw_curvature(curvature, found)
    curves = axis.lines[: len(found.circles)]
    lines = curvature.lines[1 : 1 + len(found.circles)]
    for each, curve, line in zip(found.circles, curves, lines, strict=True):
        assert curve.get_label().endswith(f"radius {1e3 * each.radius:.1f} mm")
        off = np.asarray(curve.get_ydata())
        distance = 1e3 * np.hypot(*(each.part - each.centre).T)
        assert np.abs(off) == pytest.approx(np.abs(distance - 1e3 * abs(each.radius)))
        low, high = each.window
        assert low - 1.0 <= min(curve.get_xdata()) < max(curve.get_xdata()) <= high + 1.0
        assert line.get_ydata()[0] == pytest.approx(1e-3 / each.radius)
    # Where they lie on each other the later ones are thinner
    widths = [line.get_linewidth() for line in lines]
    assert widths == sorted(widths, reverse=True)
    assert len(set(widths)) == len(widths)


def test_nothing_is_cut_at_the_pictures_edges(found: Fit) -> None:
    from PIL import Image

    with Image.open(io.BytesIO(picture(found, "a_long_name_of_a_mesh_$_of_somebody.stl"))) as image:
        pixels = np.asarray(image.convert("L"))
    assert (pixels < 200).any()
    for edge in (pixels[0], pixels[-1], pixels[:, 0], pixels[:, -1]):
        assert edge.min() == 255
