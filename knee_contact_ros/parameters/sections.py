"""How parameters are declared: rules for values, and the sections that both nodes have.

A parameter is an attribute of a section: its type, default and limits, and below it its unit and meaning.
"""

import ast
import inspect
import math
from collections.abc import Callable, Iterable, Mapping
from contextlib import suppress
from dataclasses import dataclass
from difflib import get_close_matches
from functools import cache
from itertools import pairwise
from textwrap import dedent
from typing import Annotated, Any, ClassVar, NamedTuple

from pydantic import (
    AfterValidator,
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Field,
    ValidationError,
)

from .sources import (
    JOINT_STATE_TYPE,
    SOURCE_FORM,
    WRENCH_STAMPED_TYPE,
    TopicSource,
    orientation_source,
    source_of,
)


@dataclass(frozen=True)
class AllowedValues(AfterValidator):
    """Rule for the values of a parameter; pydantic checks it after the type."""

    words: str
    """What is allowed"""


def allowed_if(allows: Callable[[Any], bool], words: str) -> AllowedValues:
    """Return a rule that allows some values, described by `words`."""

    def check(value: Any) -> Any:
        if not allows(value):
            raise ValueError(f"allowed: {words}")
        return value

    return AllowedValues(check, words)


def one_of(*allowed: str | float) -> AllowedValues:
    """Return a rule that allows these values only, and names the one that a misspelt text comes near."""
    words = ", ".join(map(str, allowed))

    def check(value: Any) -> Any:
        if value not in allowed:
            near = get_close_matches(str(value), map(str, allowed), n=1)
            raise ValueError(
                f"allowed: {words}" + "".join(f"; did you mean {each}?" for each in near)
            )
        return value

    return AllowedValues(check, words)


def off_or_at_least(least: float, zero: str = "off", numbers: str = "a number") -> AllowedValues:
    """Return a rule that allows 0, which means `zero`, and numbers from `least` on, described by `numbers`."""
    return allowed_if(
        lambda value: value == 0 or value >= least, f"0 ({zero}) or {numbers} >= {least:g}"
    )


class Declaration(NamedTuple):
    """Declaration of a parameter."""

    section: type[BaseModel]
    name: str
    """Name of the field in the section"""
    default: Any
    least: float
    """Smallest number, itself allowed unless `words` say otherwise; -inf if there is none, or for a text"""
    most: float
    """Largest number, itself allowed unless `words` say otherwise; inf if there is none, or for a text"""
    words: str
    """Limits beyond these numbers: a list, an open end, a gap; empty if there are none"""

    @property
    def description(self) -> str:
        """Unit and meaning: the text below the field, or the one it was made with."""
        made_with = self.section.model_fields[self.name].description
        return " ".join((made_with or _texts_below(self.section).get(self.name, "")).split())

    @property
    def unit(self) -> str:
        """Unit with which the description begins, as `[m]`; empty if there is none."""
        return self.description[1:].partition("]")[0] if self.description.startswith("[") else ""


@cache
def _texts_below(section: type[BaseModel]) -> dict[str, str]:
    """Return the text below each field. Pydantic would read those of all sections at each import, for 0.06 s."""
    texts = {}
    for part in reversed(section.__mro__):
        with suppress(OSError, TypeError):  # it has no source: a section that was made, or a base
            (tree,) = ast.parse(dedent(inspect.getsource(part))).body
            for field, below in pairwise(getattr(tree, "body", ())):
                if isinstance(field, ast.AnnAssign) and isinstance(below, ast.Expr):
                    texts[ast.unparse(field.target)] = str(ast.literal_eval(below.value))
    return texts


def declaration_of(section: type[BaseModel], name: str) -> Declaration:
    """Return the declaration of a parameter: its limits are the rules in its annotation."""
    field = section.model_fields[name]
    least = -math.inf
    most = math.inf
    words = []
    for limit in field.metadata:
        if isinstance(limit, AllowedValues):
            words.append(limit.words)
        # Pydantic keeps the others as Ge, Le, Gt and Lt of `annotated_types`.
        least = getattr(limit, "ge", least)
        most = getattr(limit, "le", most)
        if hasattr(limit, "gt"):
            least = limit.gt
            words.append(f"> {least:g}")
        if hasattr(limit, "lt"):
            most = limit.lt
            words.append(f"< {most:g}")
    return Declaration(section, name, field.default, least, most, "; ".join(words))


LONGEST_TEXT = 10_000
"""Largest number of characters of a text; longer ones would delay the samples of a node"""


class Section(BaseModel):
    """Group of parameters; names and types are strict, numbers finite."""

    model_config = ConfigDict(
        str_max_length=LONGEST_TEXT,
        strict=True,
        extra="forbid",
        frozen=True,
        allow_inf_nan=False,
    )


class NodeSection(Section):
    """All parameters of a node."""

    node: ClassVar[str]
    """Name of the node"""
    folder: ClassVar[str] = ""
    """Folder of the package's own parameter files for the node, within `config`"""
    force_source: ClassVar[str]
    """Name of the parameter for the source of the forces"""
    usual_forces: ClassVar[str]
    """Its default: the name of the usual topic"""

    companion: ClassVar[str]
    """Name of the node that is about the same person and knee"""
    other_names: ClassVar[Mapping[str, tuple[str, float]]]
    """Own name, and factor, by the name that the companion has for the same thing"""
    encoder: ClassVar[tuple[str, ...]]
    """Names of the parameters of the knee's encoder"""
    about_person: ClassVar[Mapping[str, str]]
    """Unit by the name of each parameter that says who the person is"""

    def problem(self) -> str:
        """Return the first combination of values that is not allowed, as name and reason; empty if there is none."""
        raise NotImplementedError

    def problem_of_sources(
        self, needed: int, why: str, counts: tuple[int, ...] = (0, 1, 3, 6)
    ) -> str:
        """Report a wrong number of fields. Forces need `needed` fields because of `why`, and one of `counts`."""
        joints, (first, second) = self.joints(), self.inputs()
        angles, forces = len(first.fields), len(second.fields)
        if angles not in (0, len(joints)) and not self.thigh():
            return f"knee.source: {angles} fields are not allowed; {', '.join(joints)} need {len(joints)}"
        if forces not in counts and forces >= needed:
            return f"{self.force_source}: {forces} fields are not allowed; a number, a force's three, or a wrench's six"
        if 0 < forces < needed:
            return f"{self.force_source}: {forces} fields are not allowed; {why} needs {needed}"
        if first.topic == second.topic and first.type != second.type:
            both = f"{self.angle_source}: {first.topic} is also the topic of {self.force_source}"
            return f"{both}, and a topic cannot have two types"
        return ""

    def inputs(self) -> tuple[TopicSource, TopicSource]:
        """Return the sources of the angles and of the forces."""
        section, _, name = self.force_source.partition(".")
        angles: str = self.knee.source  # type: ignore[attr-defined]  # every node has a knee
        forces: str = getattr(getattr(self, section), name)
        return source_of(angles, JOINT_STATE_TYPE), source_of(forces, WRENCH_STAMPED_TYPE)

    def thigh(self) -> TopicSource | None:
        """Return the source of the thigh's orientation, if the angles are made of it and of the shank's."""
        return None

    @property
    def angle_source(self) -> str:
        """Name of the parameter for the first of `inputs`."""
        return "orientations.shank" if self.thigh() else "knee.source"

    def joints(self) -> dict[str, str]:
        """Return the names of the joints that the node needs, by the parameters that give them."""
        raise NotImplementedError


_FRAME_RULE = "the name of a tf2 frame, without a slash before it"
FrameName = Annotated[
    str, allowed_if(lambda name: not name.startswith("/") and name != "_isb", _FRAME_RULE)
]
"""Name of a frame, which may be empty; `_isb` is only the suffix of a tibia frame"""
# Without a type in their text, messages of a source are of the input's own type.
AngleSource = Annotated[
    str, AllowedValues(lambda text: source_of(text, JOINT_STATE_TYPE) and text, SOURCE_FORM)
]
ForceSource = Annotated[
    str, AllowedValues(lambda text: source_of(text, WRENCH_STAMPED_TYPE) and text, SOURCE_FORM)
]
OrientationSource = Annotated[
    str, AllowedValues(lambda text: (text and orientation_source(text), text)[1], SOURCE_FORM)
]
ANGLE_SOURCE_MEANING = (
    "topic of the angles, of type JointState or dynamic_joint_states; "
    "for another type, one field for each joint"
)


def rotation_numbers(text: str) -> tuple[float, ...]:
    """Return the numbers of a rotation: roll, pitch and yaw [rad], or a quaternion x, y, z, w; none if it is empty.

    Raises:
        ValueError: the text is none of them, or the quaternion is not of unit length.
    """
    words = text.replace(",", " ").split()
    in_degrees = words[-1:] == ["deg"]
    try:
        numbers = [float(word) for word in words[: len(words) - in_degrees]]
    except ValueError:
        numbers = [math.nan]
    is_angles = len(numbers) == 3 and all(abs(number) <= MAX_TURN for number in numbers)
    is_quaternion = len(numbers) == 4 and not in_degrees
    if is_quaternion:
        is_quaternion = abs(math.hypot(*numbers) - 1.0) < MAX_LENGTH_ERROR
    if words and not is_angles and not is_quaternion:
        raise ValueError(f"allowed: {ROTATION_FORM}")
    return tuple(map(math.radians, numbers) if in_degrees else numbers)


def _rotation_text(value: object) -> object:
    """Return the text of a rotation that a parameter file gives as a list of numbers."""
    if isinstance(value, (str, bytes)) or not isinstance(value, Iterable):
        return value
    return " ".join(str(number) for number in value)


MAX_TURN = 360.0
"""Largest angle of a rotation [rad] or [deg], as a plain limit against wrong numbers"""
MAX_LENGTH_ERROR = 0.005
"""Largest difference of a quaternion's length from 1, as in tf2"""
ROTATION_FORM = "ROLL PITCH YAW in rad, or with deg behind, or a quaternion X Y Z W of unit length; such as -90 0 0 deg"
"""Form of the text of a rotation"""
Rotation = Annotated[
    str,
    BeforeValidator(_rotation_text),
    AllowedValues(lambda text: (rotation_numbers(text), text)[1], ROTATION_FORM),
]
"""Rotation from the axes of a sensor to those of the tibia, as a text; empty for none"""


class PairingSection(Section):
    """Pairing of angle and force samples by their stamps."""

    wait: float = Field(0.1, ge=0.0, le=10.0)
    """[s] how long a force waits for an angle at or after its stamp"""
    max_gap: float = Field(0.1, gt=0.0, le=3600.0)
    """[s] largest gap between stamps that is not flagged stale"""
    angle_delay: float = Field(0.0, ge=-1.0, le=1.0)
    """[s] how much later angles arrive than forces; their stamps are moved back by this"""
    queue: int = Field(20_000, ge=100, le=10**7)
    """largest number of samples of one stream that wait for the other"""


class DiagnosticsSection(Section):
    """Limits of the inputs beyond which `/diagnostics` warns or reports an error."""

    angle_warn_rate: float = Field(0.0, ge=0.0, le=1e5)
    """[Hz] warn if the angles are slower than this; 0: off"""
    angle_error_rate: float = Field(0.0, ge=0.0, le=1e5)
    """[Hz] report an error if the angles are slower than this; 0: off"""
    force_warn_rate: float = Field(0.0, ge=0.0, le=1e5)
    """[Hz] warn if the forces are slower than this; 0: off"""
    force_error_rate: float = Field(0.0, ge=0.0, le=1e5)
    """[Hz] report an error if the forces are slower than this; 0: off"""
    timeout: float = Field(1.0, gt=0.0, le=3600.0)
    """[s] an input is stale after this time without a message"""


# A section of an output names the module that describes it: see `streams/output.py`.


class RecordSection(Section):
    """Recording to MCAP."""

    output: ClassVar[str] = "knee_contact_ros.bags.recorder"

    path: str = ""
    """MCAP file to write; {stamp} in the name becomes the time; empty: do not record"""
    flush_period: float = Field(0.03, ge=0.001, le=60.0)
    """[s] period of writing to the file; a crash loses at most this much"""
    sync_period: Annotated[float, off_or_at_least(0.05)] = Field(1.0, ge=0.0, le=3600.0)
    """[s] period of syncing the disk; a power failure loses at most this much; 0: off"""
    max_size: Annotated[float, off_or_at_least(0.1)] = Field(0.0, ge=0.0, le=1e9)
    """[MB] start a new file at this size; 0: off"""
    max_duration: Annotated[float, off_or_at_least(1.0)] = Field(0.0, ge=0.0, le=1e9)
    """[s] start a new file after this span of stamps; 0: off"""
    min_free: float = Field(100.0, ge=0.0, le=1e9)
    """[MB] end the recording if the disk has less free space"""
    snapshot: float = Field(10.0, ge=0.0, le=3600.0)
    """[s] length of the snapshot that ~/save_snapshot writes, kept in memory, with at most record.queue answers and
    record.queue_size MB (30 s at 1 kHz by default); 0: off"""
    queue: int = Field(30_000, ge=100, le=10_000_000)
    """largest number of answers that wait for the process of this output"""
    queue_size: float = Field(100.0, ge=1.0, le=1e5)
    """[MB] largest memory of waiting answers"""


LONGEST_VALUE = 80
"""Largest number of characters of a value that an error shows"""


def first_error(error: ValidationError) -> str:
    """Return the first error of a validation in one line: name, value, and what is allowed."""
    first = error.errors()[0]
    name = ".".join(map(str, first["loc"]))
    reason = first["msg"].removeprefix("Value error, ").replace("Input should be", "it should be")
    if first["type"] == "missing":
        return f"{name}: is missing"
    if first["type"] == "extra_forbidden":
        return f"{name}: is not known"
    return f"{name}: {shortened(repr(first['input']))} is not allowed; {reason}"


def shortened(text: str) -> str:
    """Cut a text to the length that an error can show."""
    return text if len(text) <= LONGEST_VALUE else f"{text[:LONGEST_VALUE]}..."
