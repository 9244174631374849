"""Scenes, differences, words and tables of the study of levels."""

from __future__ import annotations

import pytest

from knee_contact_ros import load_model
from studies.choosing import __main__ as study
from studies.choosing.__main__ import changes, with_block
from studies.choosing.scenes import (
    answer_of,
    apart,
    exact,
    geometries,
    scenes,
)
from tests import ROOT

pytest.importorskip("matplotlib", minversion="3.7", reason="needs matplotlib 3.7")
SCENES = {scene.name: scene for scene in scenes()}
GAIT = "gait"


def test_the_model_meets_the_reference_on_every_geometry() -> None:
    scene = SCENES["impact"]
    short = scene._replace(time=scene.time[45:85], angle=scene.angle[45:85], load=scene.load[45:85])
    for geometry in geometries():
        model = load_model([*geometry.files, {"fidelity.tolerance": 1e-8}])
        found = answer_of(model.run(short.time, short.angle, short.load))
        worst = apart(found, exact(geometry, short))
        # Ten tolerances, as a landing multiplies what is left at the release; 1e-7 m are some 0.5 N at 2 mm of depth.
        assert worst.depth < 1e-7
        assert worst.force < 0.5
        assert worst.x < 1e-6


def test_every_change_changes_the_answer() -> None:
    scene = SCENES[GAIT]
    scene = scene._replace(time=scene.time[::8], angle=scene.angle[::8], load=scene.load[::8])
    assert all(max(study.effect(change, scene).worst) > 0.0 for change in changes())


def test_the_page_has_a_measured_part() -> None:
    text = (ROOT / "docs" / "studies" / "choosing.md").read_text(encoding="utf-8")
    assert with_block(text, "") != text
