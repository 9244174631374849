"""Finds the package's files, reads foreign files within bounds, and says how to install missing libraries.

Foreign files must be regular, not pipes or devices, and are read up to a given size. YAML is limited in the number of
nodes, their depth and the size of numbers.
"""

import errno
import hashlib
import os
import re
import stat
import sys
from collections.abc import Iterable, Mapping, Sequence
from importlib.util import find_spec
from io import BufferedReader
from itertools import accumulate
from pathlib import Path
from typing import Any

from .errors import UsageError
from .portable import READ_FLAGS

PACKAGE = "knee_contact_ros"
DEFAULT_PARAMETERS = "healthy.yaml"
"""Default parameter file"""


def share_folder() -> Path:
    """Return the share folder of the package: the source tree if this module runs from one, else beside the modules.

    Raises:
        FileNotFoundError: the package is not installed completely.
    """
    source_tree = Path(__file__).resolve().parents[2]
    if (source_tree / "package.xml").is_file():
        return source_tree
    share = _share(PACKAGE, Path(__file__).parents) or installed_share(PACKAGE)
    if share is None:
        raise FileNotFoundError(
            f"share/{PACKAGE} is neither above {__file__} nor in an ament prefix; install the package again"
        )
    return share


def ament_prefixes() -> list[str]:
    """Return the prefixes in which ROS 2 packages may be installed."""
    return [
        prefix
        for prefix in (*os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep), sys.prefix)
        if prefix
    ]


def missing_middleware() -> str:
    """Return a sentence if RMW_IMPLEMENTATION names a middleware that is not installed: ROS would just exit."""
    wanted = os.environ.get("RMW_IMPLEMENTATION", "")
    index = "share/ament_index/resource_index/rmw_typesupport"
    known = {
        each.name for prefix in ament_prefixes() for each in Path(prefix, index).glob("rmw_*_cpp")
    }
    if not wanted or not known or wanted in known:
        return ""
    there = ", ".join(sorted(known))
    return f"RMW_IMPLEMENTATION asks for {wanted}, which is not installed here (there is {there}): unset it"


def installed_share(package: str) -> Path | None:
    """Return the share folder of an installed ROS 2 package; None if there is none."""
    return _share(package, map(Path, ament_prefixes()))


def _share(package: str, prefixes: Iterable[Path]) -> Path | None:
    shares = [prefix / "share" / package for prefix in prefixes]
    return next((share for share in shares if (share / "package.xml").is_file()), None)


def find_file(name: str) -> Path:
    """Find a file that a parameter names: from the current folder, else in the package's config folder."""
    path = expand_user(name)
    if path.is_absolute() or path.exists():
        return path
    packaged = share_folder() / "config" / path
    return packaged if packaged.exists() else path


def parameter_file(name: str) -> Path:
    """Find a parameter file as by `find_file`; `.yaml` may be left out, as in `osteoarthritis`.

    Files of the load node may be given without their folder, like `insole` for `load/insole`.
    """
    names = [name, f"{name}.yaml", f"load/{name}", f"load/{name}.yaml"]
    return next((path for path in map(find_file, names) if path.is_file()), find_file(name))


def shipped_parameter_files(folder: str = "") -> list[Path]:
    """Return the parameter files of the package in a folder within `config`, the default first."""
    files = sorted((share_folder() / "config" / folder).glob("*.yaml"))
    return sorted(files, key=lambda path: path.name != DEFAULT_PARAMETERS)


def expand_user(name: str) -> Path:
    """Return a path with `~` and `~user` expanded; unchanged if there is no such user."""
    try:
        return Path(name).expanduser()
    except RuntimeError:
        return Path(name)


def check_distinct(paths: Sequence[Path], what: str = "") -> None:
    """Check that no file is given twice, under whatever names; `what` precedes the name in the error.

    Raises:
        UsageError: a file is given twice.
    """
    places = [path.resolve() for path in paths]
    for number, path in enumerate(paths):
        if places[number] in places[:number]:
            raise UsageError(f"{what}{path} is given twice")


HASH_BLOCK_SIZE = 1 << 18
"""Number of bytes read at a time"""


def open_regular(path: Path) -> BufferedReader:
    """Open a regular file for reading.

    Raises:
        OSError: it cannot be opened, or is not a regular file (but a folder, pipe, socket or device).
    """
    if path.is_dir():
        raise OSError(errno.EISDIR, os.strerror(errno.EISDIR), str(path))
    try:
        descriptor = os.open(path, READ_FLAGS)
    except ValueError:  # a zero byte, or a character that no file's name has
        raise OSError(errno.EINVAL, "no file can have this name", str(path)) from None
    try:
        if not stat.S_ISREG(os.fstat(descriptor).st_mode):
            raise OSError(errno.EINVAL, "it is no regular file", str(path))
    except BaseException:
        os.close(descriptor)
        raise
    return os.fdopen(descriptor, "rb")  # which closes the descriptor if it fails or is interrupted


def is_file(path: Path) -> bool:
    """Return whether a path is a regular file; False for a name that is too long."""
    try:
        return path.is_file()
    except OSError:
        return False


def read_regular(path: Path, most: int) -> bytes:
    """Read the content of a regular file.

    Raises:
        OSError: the file cannot be opened (see `open_regular`), or is longer than `most` bytes.
    """
    with open_regular(path) as file:
        content = file.read(most + 1)
    if len(content) > most:
        raise OSError(errno.EFBIG, f"it is longer than {most} bytes", str(path))
    return content


def sha256_of(file: BufferedReader) -> str:
    """Return the SHA-256 of the rest of a file, in hexadecimal digits."""
    digest = hashlib.sha256()
    while part := file.read(HASH_BLOCK_SIZE):
        digest.update(part)
    return digest.hexdigest()


MAX_FILE_SIZE = 2**16
"""Default of the largest size of a file [B]: one with all parameters has about 3000"""
MAX_METADATA_SIZE = 2**20
"""Largest size [B] of the `metadata.yaml` of a rosbag2 folder: a thousand topics, or some thousand files"""
MAX_NODES = 100_000
"""Largest number of texts, numbers, lists and mappings; repeats by aliases count each time"""
MAX_DEPTH = 50
"""Largest depth of nested lists and mappings"""
MAX_INTEGER_BITS = 64
"""Largest number of bits of an integer"""
TOO_DEEP = f"it is nested deeper than {MAX_DEPTH} levels"
BRACKETS = re.compile(r"[\[\]{}]")
MERGE = re.compile(r"""<<['"]?\s*:""")
"""Merge key, which inserts the entries of other mappings: the parser does so before they can be counted"""
SURROGATE = re.compile("[\ud800-\udfff]")
"""Surrogate, which an escape may give: UTF-8 has none"""
END = object()


class BadYamlError(ValueError):
    """A text is not YAML, or exceeds the bounds; the text of the error is one line."""


def read_yaml(path: Path, most: int = MAX_FILE_SIZE) -> Any:
    """Read a YAML file of at most `most` bytes.

    Raises:
        OSError: it cannot be read, is not a regular file, or is too long.
        BadYamlError: it is not YAML in UTF-8, or exceeds the bounds.
    """
    try:
        return parse_yaml(read_regular(path, most).decode("utf-8"))
    except UnicodeDecodeError as error:
        raise BadYamlError(str(error)) from None


def parse_yaml(text: str) -> Any:
    """Parse a YAML text.

    Raises:
        BadYamlError: it is not YAML, or exceeds the bounds.
    """
    from ruamel.yaml import YAML

    if bracket_depth(text) > MAX_DEPTH:  # the parser would take seconds to find out
        raise BadYamlError(TOO_DEEP)
    if MERGE.search(text):
        raise BadYamlError("merge keys (<<) are not read")
    try:
        content = YAML(typ="safe", pure=True).load(text)
    except RecursionError:
        raise BadYamlError(TOO_DEEP) from None
    except Exception as error:  # dates that are none, numbers of thousands of digits: the parser raises what it likes
        raise BadYamlError(" ".join(str(error).split()) or type(error).__name__) from None
    _check_bounds(content)
    return content


def read_mapping(
    path: Path, kind: str = "parameter file", what: str = "node names to ros__parameters"
) -> Mapping[str, Any]:
    """Read a YAML file that holds a mapping; errors call it a `kind` that must map `what`.

    Raises:
        UsageError: it cannot be read, or is not a mapping.
    """
    try:
        content = read_yaml(path)
    except OSError as error:
        raise UsageError(f"{path}: cannot read the {kind}: {error.strerror}") from None
    except BadYamlError as error:
        raise UsageError(f"{path}: not a YAML file: {error}") from None
    if not isinstance(content, Mapping):
        raise UsageError(f"{path}: not a {kind}: it must map {what}")
    return content


def bracket_depth(text: str) -> int:
    """Return the largest number of brackets that are open at a time in a YAML text, also within its texts."""
    return max(
        accumulate(1 if bracket in "[{" else -1 for bracket in BRACKETS.findall(text)), default=0
    )


def _check_bounds(content: Any) -> None:
    """Refuse content that exceeds the bounds, which would take long to process; aliases count each time."""
    branches = [iter([content])]
    nodes = 0
    while branches:
        node = next(branches[-1], END)
        if node is END:
            branches.pop()
            continue
        nodes += 1
        if nodes > MAX_NODES:
            raise BadYamlError(f"it has more than {MAX_NODES} nodes")
        if isinstance(node, int) and node.bit_length() > MAX_INTEGER_BITS:
            raise BadYamlError(
                f"it has a number of {node.bit_length()} bits; at most {MAX_INTEGER_BITS} are allowed"
            )
        if isinstance(node, str) and SURROGATE.search(node):
            raise BadYamlError("it has half a character, which cannot be written")
        if isinstance(node, (Mapping, list, tuple, set)):
            if len(branches) > MAX_DEPTH:
                raise BadYamlError(TOO_DEEP)
            branches.append(iter([*node, *node.values()] if isinstance(node, Mapping) else node))


def split_rule(rule: str, option: str) -> tuple[str, str]:
    """Split a rule of an option into its two sides.

    Raises:
        UsageError: a side is missing.
    """
    left, separator, right = (part.strip() for part in rule.partition(":="))
    if not (left and separator and right):
        raise UsageError(f"{option} {rule!r}: it must be NAME:=VALUE, as on ROS 2's command line")
    return left, right


def require(extra: str, *libraries: str) -> None:
    """Check that libraries of an extra are installed; none is imported.

    Raises:
        UsageError: one is missing.
    """
    for library in libraries:
        if find_spec(library) is None:
            raise UsageError(not_installed(library, extra))


def not_installed(library: str, extra: str) -> str:
    """Return the message for a missing library of an extra."""
    return f"{library} is not installed; {install_command(extra)}"


def install_command(extra: str) -> str:
    """Return the command that installs an extra, and the folder in which to run it."""
    source = share_folder()
    if Path(sys.prefix) == source / ".venv":
        return f"in {source}: .venv/bin/uv pip install -e '.[{extra}]'"
    keep = " --config-settings messages=yes" if find_spec(f"{PACKAGE}.msg") else ""
    return f"in the folder of the package's sources: {sys.executable} -m pip install{keep} '.[{extra}]'"
