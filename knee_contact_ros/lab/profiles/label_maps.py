"""Label maps, which have a number for every voxel: NIfTI by nibabel; NRRD and MetaImage by their text headers.

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
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from knee_contact_ros.model.types import Floats
from knee_contact_ros.system.errors import UsageError

HEADER = 2**16
"""Largest size of a text header [B]"""
MOST_VOXELS = 2**31
TYPES = {
    "int8": ("signed char", "int8_t", "MET_CHAR"), "uint8": ("uchar", "unsigned char", "uint8_t", "MET_UCHAR"),
    "int16": ("short", "short int", "signed short", "int16_t", "MET_SHORT"),
    "uint16": ("ushort", "unsigned short", "uint16_t", "MET_USHORT"),
    "int32": ("int", "signed int", "int32_t", "MET_INT"), "uint32": ("uint", "unsigned int", "uint32_t", "MET_UINT"),
    "int64": ("longlong", "long long", "int64_t", "MET_LONG_LONG"),
    "uint64": ("ulonglong", "unsigned long long", "uint64_t", "MET_ULONG_LONG"),
    "float32": ("float", "MET_FLOAT"), "float64": ("double", "MET_DOUBLE"),
}  # fmt: skip
"""Names of the types of numbers in headers, by NumPy's"""
NUMBER = re.compile(r"[-+0-9.eE]+")


class LabelMap(NamedTuple):
    """Labels of voxels, and where these lie."""

    values: NDArray[Any]
    """Shape (i, j, k)"""
    affine: Floats
    """Turns indices of voxels into a scanner's RAS axes [mm]; shape (4, 4)"""
    lacks: str = ""
    """What the header does not say of the orientation; the affine then is in the voxels' own axes. Empty: it says it"""


def read_label_map(path: Path) -> LabelMap:
    """Read a label map; the suffix tells its kind.

    Raises:
        UsageError: it cannot be read, or has not three dimensions.
    """
    reader = next(reader for suffix, reader in LABEL_MAPS.items() if path.name.lower().endswith(suffix))
    try:
        found = reader(path)
    except Exception as error:  # nibabel raises its own, EOFError, zlib's and more
        raise UsageError(f"{path} cannot be read: {' '.join(str(error).split())[:200]}") from None
    values = found.values
    values = values.reshape(values.shape[:3]) if values.ndim > 3 and set(values.shape[3:]) == {1} else values
    if values.ndim != 3:
        raise UsageError(f"{path} has {values.ndim} dimensions; a label map has 3")
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
    head, data = (content[: end.start()], content[end.end() :]) if end else (content, b"")
    if not head.startswith(b"NRRD"):
        raise ValueError("it does not begin with NRRD")
    lines = [line.split(":", 1) for line in head.decode("latin-1").splitlines()[1:] if ":" in line]
    fields = {key.strip().lower(): value.strip(" =") for key, value in lines}
    if fields.get("dimension") != "3" or fields.get("byte skip", "0") != "0" or fields.get("line skip", "0") != "0":
        raise ValueError("a map has dimension 3, without byte skip and line skip")
    if name := fields.get("data file") or fields.get("datafile"):
        data = (path.parent / name).read_bytes()
    values = _voxels(data, fields["type"], _numbers(fields["sizes"]), fields["encoding"], fields.get("endian") == "big")
    space = fields.get("space", "")
    letters = space if len(space) == 3 else "".join(word[:1] for word in space.split("-"))
    directions = fields.get("space directions", "")
    if not re.fullmatch("[RL][AP][SI]", letters.upper()) or "none" in directions or not directions:
        return LabelMap(
            values, np.diag([*_numbers(fields.get("spacings", "1 1 1")), 1.0]), "it has no space directions"
        )
    turn = np.array([1.0 if letter in "RAS" else -1.0 for letter in letters.upper()])
    origin = _numbers(fields.get("space origin", "0 0 0"))
    scale = {"mm": 1.0, "cm": 10.0, "m": 1e3}[(re.findall('"(.*?)"', fields.get("space units", "")) or ["mm"])[0]]
    return LabelMap(values, _affine(_numbers(directions), origin, scale * turn))


def _meta_image(path: Path) -> LabelMap:
    content = path.read_bytes()
    head, key, rest = content.partition(b"ElementDataFile")
    if not key:
        raise ValueError("it has no ElementDataFile")
    line, _, data = rest.partition(b"\n")
    lines = [line.split("=", 1) for line in head[:HEADER].decode("latin-1").splitlines() if "=" in line]
    fields = {key.strip().lower(): value.strip() for key, value in lines}
    name = line.decode().strip(" =\r")
    if name.upper() != "LOCAL":
        data = (path.parent / name).read_bytes()
    if fields.get("elementnumberofchannels", "1") != "1":
        raise ValueError("a map has one channel")

    def flag(*names: str) -> bool:
        return any(fields.get(name, "").lower() == "true" for name in names)

    encoding = "gzip" if flag("compresseddata") else "raw"
    big = flag("binarydatabyteordermsb", "elementbyteordermsb")
    values = _voxels(data, fields["elementtype"], _numbers(fields["dimsize"]), encoding, big)
    matrix, origin = (
        next((fields[name] for name in names if name in fields), None)
        for names in (("transformmatrix", "rotation", "orientation"), ("offset", "position", "origin"))
    )
    spacing = np.array(_numbers(fields.get("elementspacing", "1 1 1")))
    if matrix is None:
        return LabelMap(values, np.diag([*spacing, 1.0]), "it has no TransformMatrix")
    directions = np.array(_numbers(matrix)).reshape(3, 3) * spacing[:, None]
    return LabelMap(values, _affine(directions.ravel(), _numbers(origin or "0 0 0"), np.array([-1.0, -1.0, 1.0])))


def _numbers(text: str) -> list[float]:
    return [float(number) for number in NUMBER.findall(text)]


def _affine(directions: Any, origin: Any, turn: Floats) -> Floats:
    """Affine from directions of the voxels' axes, one after another, and an origin, that `turn` scales and turns."""
    affine = np.eye(4)
    affine[:3, :3], affine[:3, 3] = np.reshape(directions, (3, 3)).T, origin
    affine[:3] *= turn[:, None]
    if abs(np.linalg.det(affine)) < 1e-12:
        raise ValueError("the directions of its axes span no space")
    return affine


def _voxels(data: bytes, kind: str, sizes: list[float], encoding: str, big: bool) -> NDArray[Any]:
    """Decode the numbers of voxels, the first axis fastest."""
    name = next((ours for ours, theirs in TYPES.items() if kind.strip() in (ours, *theirs)), None)
    if name is None:
        raise ValueError(f"its numbers are of the type {kind}")
    dtype, shape = np.dtype(name).newbyteorder(">" if big else "<"), tuple(int(size) for size in sizes)
    number = math.prod(shape)
    if not 0 < number <= MOST_VOXELS:
        raise ValueError(f"it has the size {shape}")
    if encoding in {"text", "txt", "ascii"}:
        return np.array(data.split(), name).reshape(shape, order="F")
    if encoding in {"gzip", "gz"}:  # MetaImage has zlib's header, NRRD gzip's
        data = gzip.decompress(data) if data[:2] == b"\x1f\x8b" else zlib.decompress(data)
    elif encoding in {"bzip2", "bz2"}:
        data = bz2.decompress(data)
    elif encoding != "raw":
        raise ValueError(f"its encoding is {encoding}")
    if len(data) < number * dtype.itemsize:
        raise ValueError(f"it has {len(data)} of {number * dtype.itemsize} B")
    return np.frombuffer(data, dtype, number).reshape(shape, order="F")


LABEL_MAPS = {
    ".nii": _nifti, ".nii.gz": _nifti, ".nrrd": _nrrd, ".nhdr": _nrrd, ".mha": _meta_image, ".mhd": _meta_image,
}  # fmt: skip
"""Reader by the suffix of a file"""
