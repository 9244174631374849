"""What comes out of meshes of known shape."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

from knee_contact_ros import load_model
from knee_contact_ros.bags.provenance import read_provenance
from knee_contact_ros.commands.main import main
from knee_contact_ros.lab.profiles.fit import TOLERANCE, Fit, concave, dented, fit
from knee_contact_ros.lab.profiles.surfaces import Surface, contact_centre
from knee_contact_ros.model.surfaces import Profile
from tests.lab.profiles.meshes import EDGE, MIDDLE, ONE_RADIUS, TWO_RADII, femoral_curve, saved, swept, tibial_curve

pytest.importorskip("pyvista", reason="needs the extra mesh")
pytest.importorskip("trimesh")
pytest.importorskip("matplotlib")

MM = 1e-3
FACET = EDGE**2 / (8.0 * 0.020)
"""[m] How far flat triangles cut into the surface; the smallest radius is that of the ridge"""
OF_ARC = 1.0 - np.cos(np.radians(20.0))
"""Height of an arc of 40 degrees in radii: a fitted radius errs by about the error of the points over that"""


def surface(mesh: tuple[np.ndarray, np.ndarray]) -> Surface:
    return Surface(Path("made.stl"), *mesh)


def femur(arcs: tuple[tuple[float, float, float], ...] = ONE_RADIUS, **how: float) -> Surface:
    return surface(swept(femoral_curve(arcs), **how))


def radii(found: Fit) -> dict[tuple[float, float], float]:
    return {each.window: each.radius for each in found.circles}


def test_a_circle_comes_out_as_that_circle() -> None:
    found = fit(femur(), MIDDLE)
    windows = radii(found)
    assert list(windows) == [(-15.0, 25.0), (20.0, 70.0), (60.0, 110.0)]
    assert list(windows.values()) == pytest.approx([0.030] * 3, abs=FACET / OF_ARC + 0.02 * MM)
    assert found.smoothed.largest < 2.0 * FACET
    assert not dented(found.shape)
    # Nothing but circle: the curvature is that of the radius, to what the facets make of it over some mm.
    assert 1.0 / found.shape.curvature == pytest.approx(0.030, rel=0.01)


def test_two_radii_are_told_apart_within_the_tolerance() -> None:
    """Smoothing blurs where they meet; more so with a larger tolerance."""
    errors = []
    for tolerance in (0.01 * MM, TOLERANCE):
        found = fit(femur(TWO_RADII), MIDDLE, tolerance=tolerance)
        assert found.smoothed.deviation <= np.hypot(found.smoothed.roughness, tolerance) * 1.001
        windows = radii(found)
        expected = {(-15.0, 25.0): 0.034, (60.0, 110.0): 0.022}
        errors.append([abs(windows[name] - radius) for name, radius in expected.items()])
        # That is RMS; where the radii meet it is up to twice as much.
        assert max(errors[-1]) < 2.0 * np.hypot(found.smoothed.roughness, tolerance) / OF_ARC
    assert sum(errors[0]) < sum(errors[1])


def test_a_larger_tolerance_is_smoother_and_further_off() -> None:
    rough, smooth = (fit(femur(TWO_RADII, noise=0.1 * MM), MIDDLE, tolerance=t) for t in (0.02 * MM, 0.2 * MM))
    assert smooth.smoothed.rms > rough.smoothed.rms
    bends = [np.abs(np.diff(each.shape.curvature, 2)).sum() for each in (rough, smooth)]
    assert bends[1] < bends[0]


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_noise_neither_dents_the_profile_nor_bends_its_circles(seed: int) -> None:
    found = fit(femur(noise=0.15 * MM, seed=seed), MIDDLE)
    assert not dented(found.shape)
    # A point of the slice is the mean of two vertices, or one: RMS 0.11 to 0.15 mm; half is left to chance.
    assert 0.05 * MM < found.smoothed.roughness < 0.2 * MM
    # Some 500 points of the slab share three such arcs: 0.15 mm / sqrt(100) in height, over the arc's height, twofold.
    assert list(radii(found).values()) == pytest.approx([0.030] * 3, abs=2.0 * 0.015 * MM / OF_ARC)


def test_noise_moves_the_contact_point_little() -> None:
    angles = np.radians(np.linspace(0.0, 70.0, 141))

    def path(noise: float, seed: int) -> np.ndarray:
        profile = Profile(*fit(femur(TWO_RADII, noise=noise, seed=seed), MIDDLE).smoothed.points.T)
        return np.array([-profile.support(angle)[1] for angle in angles])

    clean = path(0.0, 0)
    shifts = [np.abs(path(0.1 * MM, seed) - clean).max() for seed in range(1, 6)]
    assert max(shifts) < 0.2 * MM  # the limit that is promised


def test_a_dent_is_bridged() -> None:
    """A profile is convex, whatever the slice is."""
    points, normals = femoral_curve()
    angle = np.degrees(np.arctan2(-normals[:, 0], -normals[:, 1]))
    dent = 0.3 * MM * np.exp(-(((angle - 30.0) / 6.0) ** 2))
    found = fit(surface(swept((points - normals * dent[:, None], normals))), MIDDLE)
    assert not dented(found.shape)
    assert found.smoothed.deviations.min() < -0.1 * MM  # most of the dent is still below the profile


def test_cartilage_is_as_thick_as_it_was_made(tmp_path: Path) -> None:
    found = fit(femur(TWO_RADII), MIDDLE, bone=femur(TWO_RADII, inwards=2.5 * MM))
    assert found.thickness is not None
    # The profile may lie off by the tolerance; the middle of the slab lies in the slice itself.
    assert found.thickness.mean == pytest.approx(2.5 * MM, abs=TOLERANCE + FACET)


def test_a_concave_tibia() -> None:
    found = fit(
        surface(swept(tibial_curve())),
        MIDDLE,
        femur=False,
        bone=surface(swept(tibial_curve(), inwards=1.7 * MM)),
    )
    assert found.thickness is not None
    assert found.thickness.mean == pytest.approx(1.7 * MM, abs=TOLERANCE)
    # The widest window is 22 mm: 0.6 mm high, on which facets of `FACET` tell by 0.5 %, and smoothing likewise.
    assert [each.radius for each in found.circles] == pytest.approx([0.095] * 4, rel=0.03)
    ((low, high),) = concave(found.shape)
    assert low < -0.017
    assert high > 0.017


def test_a_closed_cartilage_gives_its_outer_side() -> None:
    """As from a segmentation: articular side, bone side and rims in one mesh."""
    outer, inner = swept(femoral_curve()), swept(femoral_curve(), inwards=2.0 * MM)
    rows, columns = len(femoral_curve()[0]), 29
    corner = np.arange(rows * columns).reshape(rows, columns)
    rim = np.concatenate([corner[:, 0], corner[-1, 1:], corner[::-1, -1][1:], corner[0, ::-1][1:]])
    below = rim + rows * columns
    walls = np.concatenate(
        [np.column_stack([rim[:-1], rim[1:], below[:-1]]), np.column_stack([rim[1:], below[1:], below[:-1]])]
    )
    mesh = (
        np.concatenate([outer[0], inner[0]]),
        np.concatenate([outer[1], inner[1] + rows * columns, walls]),
    )
    found = fit(surface(mesh), MIDDLE)
    assert any("lie behind the rest" in remark for remark in found.remarks)
    assert list(radii(found).values()) == pytest.approx([0.030] * 3, abs=FACET / OF_ARC + 0.05 * MM)


def test_bone_and_cartilage_in_one_mesh_give_the_cartilage() -> None:
    cartilage, bone = swept(femoral_curve()), swept(femoral_curve(), inwards=2.0 * MM)
    both = np.concatenate([cartilage[0], bone[0]]), np.concatenate([cartilage[1], bone[1] + len(cartilage[0])])
    found = fit(surface(both), MIDDLE)
    assert any("has 2 pieces" in remark for remark in found.remarks)
    assert list(radii(found).values()) == pytest.approx([0.030] * 3, abs=FACET / OF_ARC + 0.02 * MM)


def test_a_slice_at_the_rim_is_fitted_alone() -> None:
    found = fit(femur(), MIDDLE + 9.4 * MM)
    assert "the slab of 2 mm reaches beyond the surface" in found.remarks
    fall = 0.020 - np.sqrt(0.020**2 - (9.4 * MM) ** 2)
    assert found.circles[0].radius == pytest.approx(0.030 - fall, abs=2.0 * FACET / OF_ARC)  # steep: facets cut deeper


def test_the_automatic_slice_is_that_of_the_ridge() -> None:
    assert contact_centre(femur(TWO_RADII), True, True) == pytest.approx(MIDDLE, abs=0.05 * MM + EDGE / 2.0)
    assert contact_centre(surface(swept(tibial_curve())), False, True) == pytest.approx(MIDDLE, abs=0.05 * MM)


def test_solve_takes_what_was_fitted(right_bag: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    mesh = saved(tmp_path / "femur.stl", swept(femoral_curve(TWO_RADII)))
    bone = saved(tmp_path / "bone.stl", swept(femoral_curve(TWO_RADII), inwards=2.5 * MM))
    output = tmp_path / "new" / "profile.csv"
    output.parent.mkdir()
    arguments = ["fit-profile", str(mesh), "--slice", "-18", "--bone", str(bone), "--output", str(output)]
    assert main(arguments) == 0
    told = capsys.readouterr().out
    for words in ("convex everywhere", "normals of -15° to 25°", "0.05 mm RMS"):
        assert words in told
    depth = re.search(r"thickness: (\S+)", told)
    assert depth
    assert float(depth[1]) == pytest.approx(2.5 * MM, abs=TOLERANCE)
    assert sorted(path.name for path in output.parent.iterdir()) == ["profile.csv", "profile.png", "profile.yaml"]
    parameters = ["--params", "healthy.yaml", "-p", "femur.geometry:=profile", "-p", f"femur.profile:={output}"]
    assert main(["solve", str(right_bag), *parameters, "--output", str(tmp_path / "a.mcap")]) == 0


def test_a_fitted_cartilage_leaves_the_disease_its_own(
    right_bag: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """2.5 mm of cartilage were fitted; osteoarthritis.yaml says 0.5 mm, before it and after it."""
    femur, bone = (saved(tmp_path / f"{name}.stl", swept(femoral_curve(TWO_RADII), inwards=inwards))
                   for name, inwards in (("femur", 0.0), ("bone", 2.5 * MM)))  # fmt: skip
    profile = tmp_path / "profile.csv"
    assert main(["fit-profile", str(femur), "--slice", "-18", "--bone", str(bone), "--output", str(profile)]) == 0
    files = ["osteoarthritis.yaml", str(profile.with_suffix(".yaml"))]
    for number, (first, second) in enumerate((files, files[::-1])):
        capsys.readouterr()
        recording = tmp_path / f"{number}.mcap"
        arguments = ["--params", first, "--params", second, "--output", str(recording)]
        assert main(["solve", str(right_bag), *arguments]) == 0
        assert re.search(r"largest .* 0\.538 ", capsys.readouterr().out)  # of the healthy law: 0.747 mm
        stored = read_provenance(recording)
        assert stored is not None
        assert stored.parameters.femur.profile == str(profile)
        assert stored.parameters.contact.law == "two_layer_viscoelastic"


def test_a_model_takes_a_tibia(config: Path, tmp_path: Path) -> None:
    """Its origin lies on the surface, however high the mesh does."""
    points, triangles = swept(tibial_curve())
    mesh = saved(tmp_path / "tibia.ply", (points - np.array([0.0, 0.023, 0.0]), triangles))
    output = tmp_path / "tibia.csv"
    assert main(["fit-profile", str(mesh), "--side", "tibia", "--slice", "auto", "--output", str(output)]) == 0
    x, y = np.genfromtxt(output, delimiter=",", skip_header=6).T
    assert np.interp(0.0, x, y) == pytest.approx(0.0, abs=1e-6)  # between points 0.75 mm apart on a radius of 95 mm
    model = load_model([config / "healthy.yaml", output.with_suffix(".yaml")])
    assert model.run(np.array([0.0, 0.01]), np.array([0.1, 0.2]), np.array([800.0, 800.0])).penetration_depth[1] > 0.0
