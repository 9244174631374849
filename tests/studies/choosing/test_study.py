"""Scenes, differences, words and tables of the study of levels."""

from knee_contact_ros import load_model
from studies.choosing.scenes import (
    answer_of,
    apart,
    exact,
    geometries,
    scenes,
)

SCENES = {scene.name: scene for scene in scenes()}


def test_the_model_meets_the_reference_on_every_geometry():
    scene = SCENES["impact"]
    short = scene._replace(
        time=scene.time[45:85], angle=scene.angle[45:85], load=scene.load[45:85]
    )
    for geometry in geometries():
        model = load_model([*geometry.files, {"fidelity.tolerance": 1e-8}])
        found = answer_of(model.run(short.time, short.angle, short.load))
        worst = apart(found, exact(geometry, short))
        # Ten tolerances, as a landing multiplies what is left at the release; 1e-7 m are some 0.5 N at 2 mm of depth.
        assert worst.depth < 1e-7
        assert worst.force < 0.5
        assert worst.x < 1e-6
