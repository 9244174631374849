"""Label maps, with a number for every voxel: NIfTI by nibabel; NRRD and MetaImage by their text headers.

Every header says where the voxels lie in a scanner's axes. Ours are RAS: x to the right, y anterior, z superior.
NRRD: https://teem.sourceforge.net/nrrd/format.html. MetaImage: https://itk.org/Wiki/MetaIO/Documentation; its axes are
LPS, and a row of its TransformMatrix is the direction of an axis of the voxels.
"""

from __future__ import annotations

import bz2
import gzip
import math
import re
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from knee_contact_ros.model.types import Floats
from knee_contact_ros.system.errors import UsageError

HEADER = 2**16
"""Largest size of a text header [B]"""
TYPES = {"char": "i1", "uchar": "u1", "int": "i4", "uint": "u4", "float": "f4"}
"""NumPy types by the type names in headers, without `signed` and blanks; other names are the same in NumPy"""
UNPACKED: dict[str, Callable[[bytes], bytes]] = {
    "raw": bytes, "gzip": gzip.decompress, "gz": gzip.decompress, "bzip2": bz2.decompress, "bz2": bz2.decompress,
    "zlib": zlib.decompress,
}  # fmt: skip
NUMBER = re.compile(r"[-+0-9.eE]+")


class LabelMap(NamedTuple):
    """Labels of voxels, and where the voxels lie."""

    values: NDArray[Any]
    """Shape (i, j, k)"""
    affine: Floats
    """Transforms indices of voxels to a scanner's RAS axes [mm], shape (4, 4)"""
    lacks: str = ""
    """What the header lacks to give the orientation; the affine is then in the voxels' own axes. Empty: nothing"""


def read_label_map(path: Path) -> LabelMap:
    """Read a label map; the suffix tells its kind.

    Raises:
        UsageError: the file cannot be read, or does not have three dimensions.
    """
    reader = next(reader for suffix, reader in LABEL_MAPS.items() if path.name.lower().endswith(suffix))
    try:
        found = reader(path)
    except Exception as error:  # nibabel raises its own, EOFError, zlib's and more
        raise UsageError(f"{path} cannot be read: {' '.join(str(error).split())[:200]}") from None
    values = found.values
    values = values.reshape(values.shape[:3]) if values.ndim > 3 and set(values.shape[3:]) == {1} else values
    if values.ndim != 3 or not values.size or abs(np.linalg.det(found.affine)) < 1e-12:
        raise UsageError(f"{path}: its voxels have the shape {values.shape}; a map of three dimensions is needed")
    return found._replace(values=values)


def _nifti(path: Path) -> LabelMap:
    import nibabel

    image: Any = nibabel.load(path)
    affine = np.array(image.affine, np.float64)
    if image.header["sform_code"] or image.header["qform_code"]:
        return LabelMap(np.asarray(image.dataobj), affine)
    affine[0] *= -1.0  # nibabel turns the first axis over, as Analyze's files have it
    return LabelMap(np.asarray(image.dataobj), affine, "its sform and qform codes are 0")


def _nrrd(path: Path) -> LabelMap:
    content = path.read_bytes()
    end = re.search(rb"\r?\n\r?\n", content[:HEADER])
    head, data = (content[: end.start()], content[end.end() :]) if end else (content[:HEADER], b"")
    if not head.startswith(b"NRRD"):
        raise ValueError("it does not begin with NRRD")
    fields = _fields(head, ":")
    if fields.get("dimension") != "3" or fields.get("byte skip", "0") != "0" or fields.get("line skip", "0") != "0":
        raise ValueError("a map has dimension 3, without byte skip and line skip")
    if name := fields.get("data file") or fields.get("datafile"):
        data = (path.parent / name).read_bytes()
    values = _voxels(data, fields["type"], fields["sizes"], fields["encoding"], fields.get("endian") == "big")
    space, directions = fields.get("space", ""), fields.get("space directions", "none")
    letters = (space if len(space) == 3 else "".join(word[:1] for word in space.split("-"))).upper()
    if not re.fullmatch("[RL][AP][SI]", letters) or "none" in directions:
        spacing = _numbers(fields.get("spacings", "1 1 1"))
        return LabelMap(values, np.diag([*spacing, 1.0]), "it has no space directions")
    unit = (re.findall('"(.*?)"', fields.get("space units", "")) or ["mm"])[0]
    turn = {"mm": 1.0, "cm": 10.0, "m": 1e3}[unit] * np.array([1.0 if each in "RAS" else -1.0 for each in letters])
    return LabelMap(values, _affine(_numbers(directions), fields.get("space origin", "0 0 0"), turn))


def _meta_image(path: Path) -> LabelMap:
    head, key, rest = path.read_bytes().partition(b"ElementDataFile")
    if not key:
        raise ValueError("it has no ElementDataFile")
    line, _, data = rest.partition(b"\n")
    fields, name = _fields(head[:HEADER], "="), line.decode().strip(" =\r")
    if name.upper() != "LOCAL":
        data = (path.parent / name).read_bytes()

    def first(names: str, default: str) -> str:
        return next((fields[name] for name in names.split() if name in fields), default)

    kind = fields["elementtype"].lower().removeprefix("met_").replace("_", "")
    encoding = "zlib" if first("compresseddata", "").lower() == "true" else "raw"
    big = first("binarydatabyteordermsb elementbyteordermsb", "").lower() == "true"
    values = _voxels(data, kind, fields["dimsize"], encoding, big)
    spacing = np.array(_numbers(fields.get("elementspacing", "1 1 1")))
    matrix = _numbers(first("transformmatrix rotation orientation", ""))
    if not matrix:
        return LabelMap(values, np.diag([*spacing, 1.0]), "it has no TransformMatrix")
    directions = np.reshape(matrix, (3, 3)) * spacing[:, None]
    return LabelMap(values, _affine(directions, first("offset position origin", "0 0 0"), np.array([-1.0, -1.0, 1.0])))


def _fields(head: bytes, mark: str) -> dict[str, str]:
    """Entries of a header by lower-case names."""
    lines = [line.split(mark, 1) for line in head.decode("latin-1").splitlines() if mark in line]
    return {key.strip().lower(): value.strip(" =") for key, value in lines}


def _affine(directions: Any, origin: str, turn: Floats) -> Floats:
    """Affine from the directions of the voxels' axes, in order, and an origin, both scaled and turned by `turn`."""
    affine = np.eye(4)
    affine[:3, :3], affine[:3, 3] = np.reshape(directions, (3, 3)).T, _numbers(origin)
    affine[:3] *= turn[:, None]
    return affine


def _numbers(text: str) -> list[float]:
    return [float(number) for number in NUMBER.findall(text)]


def _voxels(data: bytes, kind: str, sizes: str, encoding: str, big: bool) -> NDArray[Any]:
    """Decode the numbers of voxels, the first axis fastest."""
    kind = kind.replace("unsigned ", "u").replace("signed ", "").removesuffix(" int").removesuffix("_t")
    dtype = np.dtype(TYPES.get(kind, kind.replace(" ", ""))).newbyteorder(">" if big else "<")
    shape = tuple(int(size) for size in _numbers(sizes))
    if encoding in {"text", "txt", "ascii"}:
        return np.array(data.split(), dtype).reshape(shape, order="F")
    data = UNPACKED[encoding](data)
    if len(data) < math.prod(shape) * dtype.itemsize:
        raise ValueError(f"it has {len(data)} of {math.prod(shape) * dtype.itemsize} B")
    return np.frombuffer(data, dtype, math.prod(shape)).reshape(shape, order="F")


LABEL_MAPS = {
    ".nii": _nifti, ".nii.gz": _nifti, ".nrrd": _nrrd, ".nhdr": _nrrd, ".mha": _meta_image, ".mhd": _meta_image,
}  # fmt: skip
"""Reader by the suffix of a file"""
