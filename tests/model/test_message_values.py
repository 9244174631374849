"""Every field of the message has a value: a field that the kernel never writes would silently be 0."""

from functools import cache

import numpy as np
import pytest
from numpy.typing import NDArray

from benchmarks.gait import gait
from knee_contact_ros import load_model
from knee_contact_ros.model.types import FLAT, MESSAGE_FIELDS

ALWAYS_0 = {"contact_point_z"}
"""All is planar"""


@cache
def fields_with_a_value():
    """Numbers that differ from 0 in the shipped gait, with MRI surfaces or two layers, or where the load lifts off."""
    time, angle, load = gait("right")
    surfaces = load_model("mri_knee").run(time, angle, load)
    layers = load_model(
        {"contact.law": "two_layer_viscoelastic", "contact.layer_depth": 2e-4}
    ).run(time, angle, load)
    lifted = load_model().run(time, angle, np.where(time > time[-1] / 2.0, -200.0, load))
    rows: NDArray[np.void] = np.concatenate([surfaces, layers, lifted]).view(FLAT)
    return frozenset(name for name in MESSAGE_FIELDS if rows[name].any())


@pytest.mark.parametrize("name", sorted(set(MESSAGE_FIELDS) - ALWAYS_0))
def test_every_number_of_the_message_differs_from_0_somewhere(name):
    assert name in fields_with_a_value(), (
        f"{name} of KneeContact.msg is 0 in all scenes: write it in write_answer (knee_contact_ros/model/answers.py), "
        "or add a scene in which it differs from 0 to tests/model/test_message_values.py"
    )
