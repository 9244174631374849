"""Parameter files mean the same to a node of ROS 2 and to the commands: generated files, read by both."""

import random

import pytest

rclpy = pytest.importorskip("rclpy")

from rclpy.context import Context  # noqa: E402
from rclpy.node import Node  # noqa: E402

from knee_contact_ros.system.errors import UsageError  # noqa: E402
from knee_contact_ros.system.ros_files import Sections, merge_sections, read_sections, values_for  # noqa: E402

NODES = (
    "/**",
    "/knee_contact",
    "knee_contact",
    "/left/knee_contact",
    "left/knee_contact",
    "/*/knee_contact",
    "/left/*",
    "/**/knee_contact",
    "/right/knee_contact",
    "/left/**",
    "/other",
    "/*",
    "/**/*",
    "/left/knee_*",
    "/left/",
    '"**"',
    "/**/left/**",
    "/left/x/knee_contact",
    "/*/*",
    "/a/b/knee_contact",
)
VALUES = (
    "5",
    "-7",
    "+5",
    "010",
    "08",
    "0x1F",
    "0b11",
    "0o17",
    "1_000",
    "1,000",
    "2:30",
    "1.5",
    "5.",
    ".5",
    "1e3",
    "1e",
    "-0",
    "1E-3",
    "0x1p3",
    "1e400",
    "9223372036854775807",
    "9223372036854775808",
    "true",
    "True",
    "yes",
    "NO",
    "on",
    "Off",
    "y",
    "N",
    "~",
    "null",
    "Null",
    ".inf",
    "-.Inf",
    "+.inf",
    ".nan",
    ".NaN",
    "inf",
    "nan",
    "infinity",
    "'5'",
    '"1.0"',
    "''",
    "!!str 5",
    "!!float 5",
    "text",
    "two words",
    "2001-01-01",
    "[1, 2]",
    "[1.5, 2.5]",
    "[1, 2.5]",
    "[a, 'b']",
    "[true, off]",
    "&a 5",
    "*a",
    "",
    "|\n        text",
    ">-\n        5",
    "0x",
    "+",
    "1.5.2",
    "- 1",
    "0777",
    "-010",
)


def generated(dice):
    """A file of some sections, with names that are nested or not, and values of all kinds."""
    lines = []
    for _ in range(dice.randint(1, 4)):
        node, indent = dice.choice(NODES), "  "
        head = [f"{node}:"]
        if dice.random() < 0.3 and node.count("/") == 2 and node[0] == "/":
            space, name = node[1:].split("/")
            head, indent = [f"{dice.choice(['', '/'])}{space}:", f"  {name}:"], "    "
        names = [
            f"{name}: {dice.choice(VALUES)}"
            for name in dice.sample(["a", "b", "c.d"], k=dice.randint(1, 3))
        ]
        nested = [f"e: {{f: {dice.choice(VALUES[:10])}}}"] if dice.random() < 0.3 else []
        lines += [
            *head,
            f"{indent}ros__parameters:",
            *(f"{indent}  {name}" for name in (*names, *nested)),
        ]
    return "\n".join(lines) + "\n"


def by_ros(files, namespace):
    """The values that a node gets; None if ROS refuses a file."""
    context, arguments = (
        Context(),
        [word for file in files for word in ("--params-file", str(file))],
    )
    try:
        rclpy.init(args=["x", "--ros-args", *arguments], context=context)
    except RuntimeError:
        return None
    try:
        node = Node(
            "knee_contact",
            context=context,
            namespace=namespace,
            enable_rosout=False,
            start_parameter_services=False,
            allow_undeclared_parameters=True,
            automatically_declare_parameters_from_overrides=True,
        )
        values = {
            name: parameter.value for name, parameter in node.get_parameters_by_prefix("").items()
        }
        node.destroy_node()
    finally:
        rclpy.shutdown(context=context)
    return {
        name: value
        for name, value in values.items()
        if name not in ("use_sim_time", "start_type_description_service")
    }


def by_us(files, namespace):
    sections: Sections = {}
    try:
        for file in files:
            merge_sections(sections, read_sections(file))
    except UsageError as error:
        return {"twice": ...} if "is given twice" in str(error) else None
    return values_for(sections, f"{namespace}/knee_contact")


@pytest.mark.parametrize("part", range(2))
def test_generated_files_mean_the_same_to_a_node(tmp_path, part):
    dice, taken = random.Random(49 + part), 0
    for number in range(50):
        files = [tmp_path / f"{number}_{count}.yaml" for count in range(dice.choice([1, 1, 2]))]
        for file in files:
            file.write_text(generated(dice))
        namespace = dice.choice(["", "/left", "/a/b"])
        found, expected = by_us(files, namespace), by_ros(files, namespace)
        if found == {"twice": ...}:  # ROS takes one of the two, by their kinds
            continue
        taken += bool(expected)
        assert repr(found) == repr(expected), "".join(file.read_text() for file in files)
    assert taken > 5
