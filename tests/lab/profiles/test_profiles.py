"""What comes out of files and meshes of known shape."""

import io
import re
from pathlib import Path

import numpy as np
import pytest

from knee_contact_ros import load_model
from knee_contact_ros.bags.provenance import read_provenance
from knee_contact_ros.commands.main import main
from knee_contact_ros.lab.profiles import picture
from knee_contact_ros.lab.profiles.fit import SMOOTHING_TOLERANCE, concave, fit
from knee_contact_ros.lab.profiles.slices import contact_centre
from knee_contact_ros.lab.profiles.surfaces import Surface, cropped, read_surface
from knee_contact_ros.model.mechanisms import hinge
from knee_contact_ros.model.profiles import Profile
from knee_contact_ros.model.surfaces import ContactPair, Plane
from studies.choosing.surfaces import read_points
from tests.lab.profiles.meshes import (
    EDGE,
    MIDDLE,
    ONE_RADIUS,
    RIDGE,
    TWO_RADII,
    VOXEL,
    femoral_curve,
    label_map,
    other_map,
    saved,
    spaced,
    swept,
    tibial_curve,
)

for library in ("pyvista", "trimesh", "matplotlib", "nibabel"):
    pytest.importorskip(library, reason="needs the extra mesh")

MM = 1e-3
FACET = EDGE**2 / (8.0 * 0.020)
"""[m] How far flat triangles cut into the surface; the smallest radius is that of the ridge"""
OF_ARC = 1.0 - np.cos(np.radians(20.0))
"""Height of an arc of 40 degrees in radii: a fitted radius errs by about the error of the points over that"""


def surface(mesh):
    return Surface(Path("made.stl"), *mesh)


def femur(arcs=ONE_RADIUS, **how):
    return surface(swept(femoral_curve(arcs), **how))


def tibia(**how):
    return surface(swept(tibial_curve(), **how))


def radii(found):
    return [each.radius for each in found.circles]


def joined(*meshes, walls=()):
    """Two meshes in one, and triangles between them."""
    (outer, faces), (inner, others) = meshes
    triangles = np.concatenate([faces, others + len(outer), *([walls] if len(walls) else [])])
    return surface((np.concatenate([outer, inner]), triangles))


def test_a_circle_comes_out_as_that_circle():
    found = fit(femur(), MIDDLE)
    assert [each.window for each in found.circles] == [(-15.0, 25.0), (20.0, 70.0), (60.0, 110.0)]
    assert radii(found) == pytest.approx([0.030] * 3, abs=FACET / OF_ARC + 0.02 * MM)
    assert found.smoothed.largest < 2.0 * FACET
    assert found.shape.curvature.min() > -1.0
    # Nothing but circle: the curvature is that of the radius, to what the facets make of it over some mm.
    assert 1.0 / found.shape.curvature == pytest.approx(0.030, rel=0.01)


def test_two_radii_are_distinguished_within_the_tolerance():
    """Smoothing blurs where they meet; more so with a larger tolerance."""
    errors = []
    for tolerance in (0.01 * MM, SMOOTHING_TOLERANCE):
        found = fit(femur(TWO_RADII), MIDDLE, tolerance=tolerance)
        allowed = np.hypot(found.smoothed.roughness, tolerance)
        assert found.smoothed.deviation <= allowed * 1.001
        errors.append([abs(radii(found)[0] - 0.034), abs(radii(found)[2] - 0.022)])
        assert (
            max(errors[-1]) < 2.0 * allowed / OF_ARC
        )  # that is RMS; where the radii meet it is up to twice as much
    assert sum(errors[0]) < sum(errors[1])


def test_noise_neither_dents_the_profile_nor_bends_its_circles():
    found = fit(femur(noise=0.15 * MM), MIDDLE)
    assert found.shape.curvature.min() > -1.0
    # A point of the slice is the mean of two vertices, or one: RMS 0.11 to 0.15 mm; half is left to chance.
    assert 0.05 * MM < found.smoothed.roughness < 0.2 * MM
    # Some 500 points of the slab share three such arcs: 0.15 mm / sqrt(100) in height, over the arc's height, twofold.
    assert radii(found) == pytest.approx([0.030] * 3, abs=2.0 * 0.015 * MM / OF_ARC)


def test_noise_moves_the_contact_point_little():
    angles = np.radians(np.linspace(0.0, 70.0, 141))

    def path(noise, seed):
        profile = Profile(*fit(femur(TWO_RADII, noise=noise, seed=seed), MIDDLE).smoothed.points.T)
        return np.array([-profile.support(angle)[1] for angle in angles])

    clean = path(0.0, 0)
    shifts = [np.abs(path(0.1 * MM, seed) - clean).max() for seed in (1, 2)]
    assert max(shifts) < 0.2 * MM  # the limit that is promised


def test_cartilage_is_as_thick_as_it_was_made_and_a_tibia_is_concave():
    found = fit(femur(TWO_RADII), MIDDLE, bone=femur(TWO_RADII, inwards=2.5 * MM))
    # The profile may lie off by the tolerance; the middle of the slab lies in the slice itself.
    assert found.thickness.mean == pytest.approx(2.5 * MM, abs=SMOOTHING_TOLERANCE + FACET)
    found = fit(tibia(), MIDDLE, femur=False, bone=tibia(inwards=1.7 * MM))
    assert found.thickness.mean == pytest.approx(1.7 * MM, abs=SMOOTHING_TOLERANCE)
    # The widest window is 22 mm: 0.6 mm high, on which facets of `FACET` tell by 0.5 %, and smoothing likewise.
    assert radii(found) == pytest.approx([0.095] * 4, rel=0.03)
    ((low, high),) = concave(found.shape)
    assert (low < -0.017, high > 0.017) == (True, True)


def test_of_a_closed_cartilage_and_of_one_with_its_bone_the_outer_side_is_taken():
    """As from a segmentation: articular side, bone side and rims in one mesh."""
    outer, inner = swept(femoral_curve()), swept(femoral_curve(), inwards=2.0 * MM)
    corner = np.arange(len(outer[0])).reshape(-1, 29)
    rim = np.concatenate([corner[:, 0], corner[-1, 1:], corner[::-1, -1][1:], corner[0, ::-1][1:]])
    below = rim + len(outer[0])
    walls = [
        np.column_stack([rim[:-1], rim[1:], below[:-1]]),
        np.column_stack([rim[1:], below[1:], below[:-1]]),
    ]
    for mesh, remark, error in (
        (joined(outer, inner, walls=np.concatenate(walls)), "of 1 pieces;", 0.05 * MM),
        (joined(outer, inner), "of 2 pieces;", 0.02 * MM),
    ):
        found = fit(mesh, MIDDLE)
        assert any(remark in each for each in found.remarks)
        assert radii(found) == pytest.approx([0.030] * 3, abs=FACET / OF_ARC + error)


def test_the_automatic_slice_is_that_of_the_ridge():
    assert contact_centre(femur(TWO_RADII), True, True) == pytest.approx(
        MIDDLE, abs=0.05 * MM + EDGE / 2.0
    )
    assert contact_centre(tibia(), False, True) == pytest.approx(MIDDLE, abs=0.05 * MM)


@pytest.mark.parametrize("off", [0.0, 15.0 * MM, 40.0 * MM])
@pytest.mark.parametrize("left", [False, True])
def test_the_automatic_slice_lies_beside_the_middle_between_the_condyles(off, left, tmp_path):
    """Wherever the scanner's zero is; a left knee is its mirror image."""
    medial, triangles = swept(femoral_curve())
    lateral = medial * [1.0, 1.0, -1.0]
    points = np.concatenate([medial, lateral]) + np.array([0.0, 0.0, off])
    faces = np.concatenate([triangles, triangles + len(medial)])
    both = points * [1.0, 1.0, -1.0] if left else points
    path = spaced(tmp_path / "a.stl", (both[:, [2, 0, 1]], faces), "RAS")
    found = contact_centre(read_surface(path, left=left), True, True)
    assert found == pytest.approx(MIDDLE + off, abs=0.05 * MM + EDGE / 2.0)


@pytest.mark.parametrize("is_femur", [True, False])
def test_of_a_whole_bone_the_end_at_the_knee_is_used(is_femur, tmp_path):
    """A shaft, and an end far away that is wider and lies more to the side than the knee's."""
    end, triangles = swept(femoral_curve() if is_femur else tibial_curve())
    up = 1.0 if is_femur else -1.0
    place = np.array([0.0, up * 0.35, -0.09])
    points = np.concatenate([end, np.array([1.0, -1.0, 1.0]) * end + place])
    path = saved(
        tmp_path / "whole.stl", (points, np.concatenate([triangles, triangles + len(end)]))
    )
    alone = saved(tmp_path / "end.stl", (end, triangles))
    found, wanted = (
        contact_centre(cropped(read_surface(each), is_femur), is_femur, True)
        for each in (path, alone)
    )
    assert found == wanted
    (remark,) = cropped(read_surface(path), is_femur).remarks
    assert "100 mm at the knee are used" in remark
    assert not cropped(read_surface(alone), is_femur).remarks


@pytest.mark.parametrize(
    ("suffix", "space", "signs"),
    [
        (".stl", "RAS", (1, 1, 1)),
        (".ply", "LPS", (-1, -1, 1)),
        (".obj", "LAS", (-1, 1, 1)),
        (".vtp", "RAS", (1, 1, 1)),
        (".vtk", "LPS", (-1, -1, 1)),
    ],
)
def test_axes_and_unit_follow_from_the_header_of_slicer(suffix, space, signs, tmp_path):
    """A right knee; the header says to which sides x, y and z point."""
    points, triangles = swept(femoral_curve())
    path = spaced(tmp_path / f"a{suffix}", (points[:, [2, 0, 1]] * signs, triangles), space)
    read = read_surface(path)
    assert np.sort(read.points, axis=0) == pytest.approx(np.sort(points, axis=0), abs=1e-6)
    assert f"follow from SPACE={space}" in read.remarks[0]
    assert read.remarks[0].endswith("--leg left")
    left = read_surface(path, left=True)
    assert left.axes != read.axes
    assert left.points[:, 2] == pytest.approx(-read.points[:, 2])
    other = read_surface(path, axes="z,x,y")
    assert f"although the header of a{suffix} says SPACE={space}" in other.remarks[0]


@pytest.mark.parametrize("separator", [" ", ","])
def test_a_cloud_of_points_gives_nearly_the_profile_of_its_mesh(separator, tmp_path):
    points, triangles = swept(femoral_curve())
    cloud = tmp_path / "a.txt"
    np.savetxt(
        cloud, points, "%.7f", delimiter=separator, header=separator.join("xyz"), comments=""
    )
    of_cloud, of_mesh = fit(read_surface(cloud), MIDDLE), fit(surface((points, triangles)), MIDDLE)
    assert any("all points of a cloud are used" in remark for remark in of_cloud.remarks)
    assert radii(of_cloud) == pytest.approx(
        radii(of_mesh), abs=0.2 * MM
    )  # facets cut in by 3 um on arcs 2 mm high
    np.savetxt(tmp_path / "slice.csv", femoral_curve()[0], delimiter=separator, header="x,y")
    of_slice = fit(read_surface(tmp_path / "slice.csv"), MIDDLE)
    assert radii(of_slice)[0] == pytest.approx(0.030, abs=1e-5)  # exact but for 1e-8 m


@pytest.mark.parametrize("spacing", [1.5 * MM, 2.0 * MM, 2.5 * MM, 3.0 * MM, 4.0 * MM])
@pytest.mark.parametrize("shift", [0.0, 0.3, 0.5])
def test_a_cloud_in_planes_gives_the_profile_between_them(spacing, shift):
    """As contours in the slices of an image; `shift` is where the slice lies between two planes, in spacings."""
    planes = spacing * (np.arange(-3, 4) + shift)
    for of_femur, (points, normals) in ((True, femoral_curve()), (False, tibial_curve())):
        fall = np.sqrt(RIDGE**2 - planes**2) - RIDGE
        contours = points + normals * fall[:, None, None]
        z = np.broadcast_to(MIDDLE + planes[:, None, None], (*contours.shape[:2], 1))
        cloud = np.concatenate([contours, z], axis=2).reshape(-1, 3)
        found = fit(
            Surface(Path("a.txt"), cloud, np.empty((0, 3), np.int64)), MIDDLE, femur=of_femur
        )
        middle, radius = ([0.0, 0.0], 0.030) if of_femur else ([0.0, 0.095], 0.095)
        sag = spacing**2 / (8.0 * RIDGE)  # of the surface between two planes
        assert np.hypot(*(found.smoothed.points - middle).T) == pytest.approx(
            radius, abs=sag + 0.02 * MM
        )
        assert radii(found) == pytest.approx([radius] * len(found.circles), rel=0.01)
        assert any("no point lies within 0.5 mm" in each for each in found.remarks) == (
            shift * spacing > 0.5 * MM
        )


def test_a_label_map(tmp_path):
    path = label_map(tmp_path / "knee.nii.gz")
    found = fit(read_surface(path, label=4), MIDDLE, bone=read_surface(path, label=1))
    # A voxel's edge lies up to half a voxel off the circle, and steps of it cancel over arcs of 20 mm.
    assert len(found.circles) >= 2
    assert radii(found) == pytest.approx([0.028] * len(found.circles), rel=0.05)
    assert found.thickness.mean == pytest.approx(3.0 * MM, abs=VOXEL * MM)


@pytest.fixture(scope="module")
def of_nifti(tmp_path_factory):
    return read_surface(label_map(tmp_path_factory.mktemp("nifti") / "knee.nii"), label=4)


@pytest.mark.parametrize(
    ("suffix", "encoding", "space"),
    [
        (".nrrd", "raw", "left-posterior-superior"),
        (".nrrd", "gzip", "RAS"),
        (".nrrd", "ascii", "LPS"),
        (".nhdr", "bzip2", "right-anterior-superior"),
        (".mha", "raw", ""),
        (".mha", "gzip", ""),
        (".mhd", "raw", ""),
    ],
)
def test_label_maps_of_other_programs_lie_where_that_of_nifti_does(
    suffix, encoding, space, tmp_path, of_nifti
):
    found = read_surface(other_map(tmp_path / f"knee{suffix}", encoding, space), label=4)
    assert found.axes == of_nifti.axes
    order = [np.lexsort(np.round(each.points, 6).T) for each in (found, of_nifti)]
    np.testing.assert_allclose(found.points[order[0]], of_nifti.points[order[1]], atol=1e-7)


def test_voxels_without_orientation_have_the_axes_that_are_given(tmp_path):
    """The middle of the image is the origin, and nothing is turned over."""
    import nibabel

    path = label_map(tmp_path / "knee.nii")
    image = nibabel.load(path)
    plain = nibabel.Nifti1Image(np.asarray(image.dataobj), None)
    plain.header.set_zooms([VOXEL] * 3)
    nibabel.save(plain, tmp_path / "plain.nii")
    there, voxels = (
        read_surface(path, label=4),
        read_surface(tmp_path / "plain.nii", axes="y,z,x", label=4),
    )
    assert np.ptp(voxels.points - there.points, axis=0) == pytest.approx(0.0, abs=1e-6)


@pytest.mark.parametrize("place", ["scanner", "hip"])
def test_a_mesh_far_from_its_origin_is_fitted_about_the_origin_that_the_refusal_names(
    place, tmp_path, capsys
):
    points, triangles = swept(femoral_curve(TWO_RADII))
    far = np.array([-0.012, 0.64, 0.0] if place == "scanner" else [0.005, -0.41, 0.0])
    mesh, output = saved(tmp_path / "a.stl", (points + far, triangles)), tmp_path / "a.csv"
    arguments = ["fit-profile", str(mesh), "--slice", "-18", "--output", str(output)]
    assert main(arguments) == 2
    cure = re.search(r"--origin=-?[\d.]+,-?[\d.]+$", capsys.readouterr().err.strip())
    assert main([*arguments, cure[0]]) == 0
    assert np.abs(np.genfromtxt(output, delimiter=",", skip_header=6)).max() < 0.050


def test_models_read_a_fitted_profile_and_osteoarthritis_keeps_its_own_depth(
    right_bag, tmp_path, capsys
):
    """2.5 mm of cartilage were fitted; osteoarthritis.yaml says 0.5 mm, before it and after it."""
    mesh, bone = (
        saved(tmp_path / f"{name}.stl", swept(femoral_curve(TWO_RADII), inwards=inwards))
        for name, inwards in (("femur", 0.0), ("bone", 2.5 * MM))
    )
    output = tmp_path / "new" / "profile.csv"
    output.parent.mkdir()
    assert (
        main(
            [
                "fit-profile",
                str(mesh),
                "--slice",
                "-18",
                "--bone",
                str(bone),
                "--output",
                str(output),
            ]
        )
        == 0
    )
    told = capsys.readouterr().out
    for words in ("convex everywhere", "normals of -15° to 25°", "by 0.050 mm (RMS)"):
        assert words in told
    depth = re.search(r"thickness: (\S+)", told)
    assert float(depth[1]) == pytest.approx(2.5 * MM, abs=SMOOTHING_TOLERANCE)
    assert sorted(path.name for path in output.parent.iterdir()) == [
        "profile.csv",
        "profile.png",
        "profile.yaml",
    ]
    files = ["osteoarthritis.yaml", str(output.with_suffix(".yaml"))]
    for number, (first, second) in enumerate((files, files[::-1])):
        recording = tmp_path / f"{number}.mcap"
        arguments = ["--params", first, "--params", second, "--output", str(recording)]
        assert main(["solve", str(right_bag), *arguments]) == 0
        assert re.search(
            r"largest .* 0\.538 ", capsys.readouterr().out
        )  # of the healthy law: 0.747 mm
        stored = read_provenance(recording)
        assert stored.parameters.femur.profile == str(output)
        assert stored.parameters.contact.law == "two_layer_viscoelastic"


def test_a_model_takes_a_tibia(tmp_path):
    """Its origin lies on the surface, however high the mesh does."""
    points, triangles = swept(tibial_curve())
    mesh = saved(tmp_path / "tibia.ply", (points - np.array([0.0, 0.023, 0.0]), triangles))
    output = tmp_path / "tibia.csv"
    assert (
        main(
            [
                "fit-profile",
                str(mesh),
                "--side",
                "tibia",
                "--slice",
                "auto",
                "--output",
                str(output),
            ]
        )
        == 0
    )
    x, y = np.genfromtxt(output, delimiter=",", skip_header=6).T
    assert np.interp(0.0, x, y) == pytest.approx(
        0.0, abs=1e-6
    )  # between points 0.75 mm apart on a radius of 95 mm
    model = load_model(["healthy", output.with_suffix(".yaml")])
    assert (
        model.run(
            np.array([0.0, 0.01]), np.array([0.1, 0.2]), np.array([800.0, 800.0])
        ).penetration_depth[1]
        > 0.0
    )


def test_the_picture_cuts_nothing():
    from PIL import Image

    found = fit(femur(), MIDDLE, bone=femur(inwards=2.0 * MM))
    with Image.open(
        io.BytesIO(picture(found, "a_long_name_of_a_mesh_$_of_somebody.stl"))
    ) as image:
        pixels = np.asarray(image.convert("L"))
    assert (pixels < 200).any()
    for edge in (pixels[0], pixels[-1], pixels[:, 0], pixels[:, -1]):
        assert edge.min() == 255


def test_a_knee_from_mri_has_the_radii_and_thicknesses_that_were_published_and_the_shipped_profile(
    reference_data, config
):
    """The one that the shipped profiles come from; it is not in the project."""
    names = (
        "_R_femur_cartilage_surface",
        "-R-femur-subchondral-bone",
        "_R_tibia_medial_cartilage_surface",
        "-R-tibia-subchondral-bone",
    )
    condyle, below, plateau, under = (
        read_surface(reference_data / f"meshes/lenhart2015{name}.stl") for name in names
    )
    of_femur, of_tibia = (
        fit(condyle, MIDDLE, bone=below),
        fit(plateau, MIDDLE, femur=False, bone=under),
    )
    first, second, third = radii(of_femur)
    assert first == pytest.approx(34.0 * MM, abs=0.5 * MM)
    assert [second, third] == pytest.approx([26.7 * MM, 21.4 * MM], abs=MM)
    assert of_femur.shape.curvature.min() > 0.0
    assert all(74.0 * MM <= radius <= 137.0 * MM for radius in radii(of_tibia))
    ((begin, end),) = concave(of_tibia.shape)
    assert begin < 0.0 < end
    thickness = [each.thickness.mean for each in (of_femur, of_tibia) if each.thickness]
    assert thickness == pytest.approx(
        [2.7 * MM, 1.7 * MM], abs=0.05 * MM
    )  # as the figures were rounded
    # The slice was chosen by others. Condyles are flat across: within a few mm the radius is the same.
    assert contact_centre(condyle, True, True) == pytest.approx(MIDDLE, abs=4.0 * MM)
    assert contact_centre(condyle, True, False) == pytest.approx(-MIDDLE, abs=8.0 * MM)
    raw = np.genfromtxt(
        reference_data / "geometry" / "femur_medial_raw.csv", delimiter=",", skip_header=4
    )
    # It is printed with 1e-5 mm, and the mesh holds 32-bit numbers.
    nearest = [np.hypot(*(of_femur.smoothed.raw / MM - point).T).min() for point in raw]
    assert max(nearest) < 2e-3
    angles = np.linspace(0.0, 1.1, 100)
    ours, shipped = of_femur.smoothed.points.T, read_points(config / "femur_medial.csv")
    pairs = [ContactPair(Profile(*points), Plane(), hinge()) for points in (ours, shipped)]
    first_path, second_path = (
        np.array([pair.closest(each, 0.0).turning for each in angles.tolist()]) for pair in pairs
    )
    # Both were smoothed to 0.05 mm RMS, by two methods. On a radius of 34 mm a wave of that height and 25 mm length
    # turns the normal by 2 pi 0.07 / 25 = 1 degree, 0.6 mm of contact point; two thirds of it are allowed.
    assert np.abs(first_path - second_path).max() < 0.4 * MM
