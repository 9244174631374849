"""What tools are told of a parameter."""

import math
from types import SimpleNamespace
from typing import Any

import pytest
from rclpy.parameter import Parameter

from knee_contact_ros.node.parameters import NodeKind, NodeParameters, described
from knee_contact_ros.parameters.files import known_parameters, load_parameters
from knee_contact_ros.parameters.schema import Parameters
from knee_contact_ros.system.errors import UsageError

FREE_TEXTS = {
    "knee.joint_name",
    "knee.height_joint_name",
    "femur.profile",
    "tibia.profile",
    "translation.table",
    "load.share_file",
    "record.path",
    "rerun.path",
    "rerun.knees",
}
"""Names and paths"""
FREE_TEXTS |= {"lateral.femur.profile", "lateral.tibia.profile"}
LIMITS_OF_OTHERS = {
    "tibia.radius",
    "contact.tibial_radius",
    "contact.exponent",
    "femur.scale",
    "tibia.scale",
}
"""Parameters that must fit others, too"""


@pytest.mark.parametrize("name", known_parameters())
def test_every_number_has_a_range_and_every_choice_a_list(name):
    declaration = known_parameters()[name]
    descriptor = described(name, declaration)
    assert descriptor.description
    ranges = [*descriptor.floating_point_range, *descriptor.integer_range]
    if isinstance(declaration.default, str):
        assert not ranges
        assert bool(descriptor.additional_constraints) != (name in FREE_TEXTS)
    elif not isinstance(declaration.default, bool):
        assert len(ranges) == 1
        assert ranges[0].from_value <= declaration.default <= ranges[0].to_value


@pytest.mark.parametrize("name", sorted(set(known_parameters()) - LIMITS_OF_OTHERS))
def test_a_range_is_that_of_the_check(name):
    """Its ends are allowed, or the descriptor says that they are not; what lies beyond never is."""
    descriptor = described(name, known_parameters()[name])
    for limits in (*descriptor.floating_point_range, *descriptor.integer_range):
        kind = type(known_parameters()[name].default)
        for end, beyond in ((limits.from_value, -1), (limits.to_value, 1)):
            if math.isinf(end) or end == 2**63 - 1:
                continue
            if not descriptor.additional_constraints:
                load_parameters({name: kind(end)})
            with pytest.raises(UsageError, match=name):
                load_parameters(
                    {name: kind(end + beyond * max(abs(end), 1) * (1 if kind is int else 1e-6))}
                )


@pytest.mark.parametrize(
    ("given", "told"),
    [((12.0, 9.3014), []), ((9.3014, 12.0), [12.0]), ((12.0, 13.0), [13.0]), ((9.3014,), [])],
)
def test_of_a_value_that_is_set_twice_at_once_the_last_one_counts(given, told):
    values = {"femur.mass": Parameter("femur.mass", value=9.3014)}
    node: Any = SimpleNamespace(get_parameters_by_prefix=lambda _: values)
    for name in (
        "add_pre_set_parameters_callback",
        "add_on_set_parameters_callback",
        "add_post_set_parameters_callback",
        "set_descriptor",
    ):
        setattr(node, name, lambda *_: None)
    node.declare_parameter = node.set_descriptor
    parameters, taken = (
        NodeParameters(node, NodeKind(Parameters, frozenset(values), Any)),
        list[float](),
    )
    parameters.user = SimpleNamespace(
        pipeline=SimpleNamespace(check_retune=id),
        retune=lambda _, changed: taken.extend(changed.values()),
    )  # type: ignore[assignment]
    changes = [Parameter("femur.mass", value=value) for value in given]
    assert parameters._on_set(changes).successful
    parameters._after_set(changes)
    assert taken == told
