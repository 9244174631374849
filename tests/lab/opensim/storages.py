"""Small files as OpenSim writes them, made by the tests: results, ground reactions, external loads, a model."""

import numpy as np

from knee_contact_ros.system.errors import UsageError

AXES = ("fx", "fy", "fz", "mx", "my", "mz", "px", "py", "pz")
TIBIA = "knee_{0}_on_tibia_{0}_in_tibia_{0}_"
DURATION = 1.2
"""[s] of a step and a bit"""
LOADS = """<?xml version="1.0"?><OpenSimDocument Version="40000"><ExternalLoads name="loads"><objects>{}</objects>
<datafile>{}</datafile></ExternalLoads></OpenSimDocument>"""
FORCE = """<ExternalForce name="{body}"><applied_to_body>{body}</applied_to_body>
<force_identifier>{stem}v</force_identifier><point_identifier>{stem}p</point_identifier>
<torque_identifier>{torque}</torque_identifier>{more}</ExternalForce>"""
MODEL = """<?xml version="1.0"?><OpenSimDocument Version="40000"><Model name="m"><BodySet><objects>
<Body name="a"><mass>30</mass></Body><Body name="b"><mass>42.6</mass></Body></objects></BodySet><JointSet><objects>{}
</objects></JointSet></Model></OpenSimDocument>"""
JOINT = (
    '<CustomJoint name="{0}"><coordinates><Coordinate name="{1}"><range>{2}</range></Coordinate></coordinates>'
    "</CustomJoint>"
)
JOINTS = (
    ("hip", "hip_flexion"),
    ("walker_knee", "knee_angle"),
    ("ankle", "ankle_angle"),
    ("subtalar", "turn"),
)
FREE = (1.0, 7.0, -2.0)
"""[N m] free moment of a plate"""
PLATE_TIME = np.linspace(0.0, DURATION, 241)
STANDS = PLATE_TIME < 0.7
"""Then the foot is in the air"""


def write_storage(path, time, columns, degrees=None):
    """A file with these columns; `degrees` is the header's inDegrees, if it has one."""
    header = [path.stem, "version=1", f"nRows={len(time)}", f"nColumns={len(columns) + 1}"]
    header += [f"inDegrees={degrees}"] if degrees else []
    lines = [*header, "", "Units are S.I. units", "endheader", "\t".join(["time", *columns])]
    lines += [
        "\t".join(f"{value:20.12f}" for value in row)
        for row in np.column_stack([time, *columns.values()])
    ]
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return path


def flexion(time):
    """Like a walking knee's [rad]: from 3 to 63 degrees."""
    return np.radians(33.0 - 30.0 * np.cos(2.0 * np.pi * time / DURATION))


def kinematics(
    path,
    sign=-1.0,
    unit="deg",
    header="yes",
    names="knee_angle_{}",
):
    """Angles of both knees, the left one half a step later."""
    time = np.linspace(0.0, DURATION, 121)
    factor = np.degrees(1.0) if unit == "deg" else 1.0
    columns = {
        names.format(side): sign * factor * flexion(time + shift)
        for side, shift in (("r", 0.0), ("l", 0.6))
    }
    hip = {"hip_flexion_r": 20.0 * np.sin(time), "knee_angle_r_beta": columns[names.format("r")]}
    return write_storage(path, time, hip | columns, header)


def reaction_columns(time, sign=1.0):
    """What acts on a tibia, one column an axis: two load peaks, and something on every other axis."""
    load = 900.0 + 900.0 * np.sin(2.0 * np.pi * time / DURATION) ** 2
    return [
        sign * values
        for values in (0.1 * load, -load, 60.0 + time, 9.0 + time, 3.0 - time, 1.0 + time)
    ]


def reactions(
    path,
    prefix=TIBIA,
    sign=1.0,
    rows=1201,
    start=0.0,
    end=DURATION,
):
    """Reactions of both knees, without points of application but zeros."""
    time = np.linspace(start, end, rows)
    values = [*reaction_columns(time, sign), *[np.zeros_like(time)] * 3]
    columns = {
        prefix.format(side) + axis: column
        for side in "rl"
        for axis, column in zip(AXES, values, strict=True)
    }
    return write_storage(path, time, columns, "no")


def plate(stem, torque="", time=PLATE_TIME):
    """Columns of a plate that a foot stands on, 0.1 m ahead of the ankle; nothing of it is a number in the air."""
    forces, points = (50.0 + time, 700.0 - 100.0 * time, -40.0 + time), (0.5, 0.0, 0.12)
    columns = {
        f"{stem}v{axis}": np.where(STANDS, force, 0.0)
        for axis, force in zip("xyz", forces, strict=True)
    }
    columns |= {
        f"{stem}p{axis}": np.where(STANDS, at, np.nan)
        for axis, at in zip("xyz", points, strict=True)
    }
    free = {
        torque + axis: np.where(STANDS, value, 3.0)
        for axis, value in zip("xyz", FREE, strict=True)
    }
    return columns | (free if torque else {})


def write_plates(path, *columns):
    """A .mot file with these plates."""
    return write_storage(
        path,
        PLATE_TIME,
        {name: values for each in columns for name, values in each.items()},
        "yes",
    )


def external(body, stem="ground_force_", torque="ground_torque_", more=""):
    """An external force on a body."""
    return FORCE.format(body=body, stem=stem, torque=torque, more=more)


def write_loads(path, data, forces):
    """An external loads file."""
    path.write_text(LOADS.format("".join(forces), data))
    return path


def write_model(path, joints=(), bounds="-2.0943951 0.17453293"):
    """A model's file of 72.6 kg, as far as names of joints and coordinates go: those of both legs, or these."""
    both = [(f"{joint}_{side}", f"{angle}_{side}") for side in "rl" for joint, angle in JOINTS]
    path.write_text(
        MODEL.format("".join(JOINT.format(*names, bounds) for names in joints or both))
    )
    return path


def outcome(function, *arguments):
    """What comes of it, or the words of a refusal."""
    try:
        return function(*arguments)
    except UsageError as fault:
        return str(fault)
