"""Label maps, which hold a number for every voxel: nibabel reads NIfTI; NRRD and MetaImage have text headers.

Every header says where the voxels lie in a scanner's axes. Ours are RAS: x to the right, y anterior, z superior.
NRRD: https://teem.sourceforge.net/nrrd/format.html. MetaImage: https://itk.org/Wiki/MetaIO/Documentation; its axes are
LPS, and a row of its TransformMatrix is the direction of an axis of the voxels.
"""

import bz2
import math
import re
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...model.types import Floats
from ...system.errors import UsageError
from ...system.files import open_regular

_LARGEST_HEADER = 2**16
"""Largest size of a text header [B]"""
_NUMPY_TYPES = {"char": "i1", "uchar": "u1", "int": "i4", "uint": "u4", "float": "f4"}
"""NumPy types by the type names in headers, without `signed` and blanks; other names are the same in NumPy"""


_PART = 2**24
"""Number of bytes that are unpacked at a time: all at once would take twice the memory"""


def _unzip(data: bytes, limit: int) -> bytearray:
    """Unpack gzip or zlib, at most `limit` bytes."""
    unpacked = bytearray()
    unpacker = zlib.decompressobj(wbits=32 + zlib.MAX_WBITS)
    while len(unpacked) < limit and not unpacker.eof:
        part = unpacker.decompress(data, min(_PART, limit - len(unpacked)))
        if not part:
            break
        unpacked += part
        data = unpacker.unconsumed_tail
    return unpacked


def _unpack_bzip2(data: bytes, limit: int) -> bytearray:
    """Unpack bzip2, at most `limit` bytes."""
    unpacked = bytearray()
    unpacker = bz2.BZ2Decompressor()
    while len(unpacked) < limit and not unpacker.eof:
        part = unpacker.decompress(data, min(_PART, limit - len(unpacked)))
        if not part:
            break
        unpacked += part
        data = b""
    return unpacked


_DECODERS: dict[str, Callable[[bytes, int], bytes | bytearray]] = {
    "raw": lambda data, _: data,
    "gzip": _unzip,
    "gz": _unzip,
    "bzip2": _unpack_bzip2,
    "bz2": _unpack_bzip2,
    "zlib": _unzip,
}
"""Functions that unpack the voxels up to a number of bytes, by the encodings in headers"""
_MOST_VOXELS = 2**26
"""Largest number of voxels: a map of a knee has 512 x 512 x 200 at most"""
_MOST_IN_TEXT = 2**22
"""Largest number of voxels that are written as text, each of which takes some 70 B while it is read"""
_TEXTS = ("text", "txt", "ascii")
"""Encodings of voxels as text"""
_LONGEST = 32
"""Longest number of a text [B]"""
_LARGEST_LEAD = 2**26
"""Largest number of bytes before the voxels of NIfTI: in a packed file they may be very many"""
_NUMBER = re.compile(r"[-+0-9.eE]+")
_MILLIMETRES = {"mm": 1.0, "cm": 10.0, "m": 1e3}
"""Factors of units of length to mm"""


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
    name = path.name.lower()
    reader = next(reader for suffix, reader in LABEL_MAPS.items() if name.endswith(suffix))
    try:
        found = reader(path)
        _check_kind(found.values.shape, found.values.dtype)
        if abs(np.linalg.det(found.affine)) < 1e-12:
            raise ValueError("its voxels have no volume")
    except Exception as error:  # nibabel raises its own, EOFError, zlib's and more
        raise UsageError(f"{path} cannot be read: {' '.join(str(error).split())[:200]}") from None
    return found._replace(values=found.values.reshape(found.values.shape[:3]))


def _read_nifti(path: Path) -> LabelMap:
    import nibabel

    image: Any = nibabel.load(path, keep_file_open=True)
    _check_size(image.shape)
    _check_kind(image.shape, image.get_data_dtype())
    stored = image.dataobj
    if stored.offset > _LARGEST_LEAD:
        raise ValueError(f"its voxels begin at byte {stored.offset}")
    slabs = (stored[:, :, k] for k in range(image.shape[2]))  # all at once take twice the memory
    first = next(slabs)
    values = np.empty(image.shape, first.dtype, order="F")
    values[:, :, 0] = first
    for k, slab in enumerate(slabs, start=1):
        values[:, :, k] = slab
    affine = np.array(image.affine, np.float64)
    if image.header["sform_code"] or image.header["qform_code"]:
        return LabelMap(values, affine)
    affine[0] *= -1.0  # nibabel turns the first axis over, as Analyze's files have it
    return LabelMap(values, affine, "its sform and qform codes are 0")


def _read_nrrd(path: Path) -> LabelMap:
    with open_regular(path) as file:
        content = file.read(_LARGEST_HEADER)
        end = re.search(rb"\r?\n\r?\n", content)
        head = content[: end.start()] if end else content
        if not head.startswith(b"NRRD"):
            raise ValueError("it does not begin with NRRD")
        fields = _fields(head, ":")
        skips = {fields.get("byte skip", "0"), fields.get("line skip", "0")}
        if fields.get("dimension") != "3" or skips != {"0"}:
            raise ValueError("a map has dimension 3, without byte skip and line skip")
        most = _most_bytes(fields["type"], fields["sizes"], fields["encoding"])
        if name := fields.get("data file") or fields.get("datafile"):
            data = _data_file(path, name, most)
        else:
            file.seek(end.end() if end else len(content))
            data = file.read(most) if end else b""
    is_big = fields.get("endian") == "big"
    values = _voxels(data, fields["type"], fields["sizes"], fields["encoding"], is_big)
    space = fields.get("space", "")
    sides = (space if len(space) == 3 else "".join(word[:1] for word in space.split("-"))).upper()
    directions = fields.get("space directions", "none")
    if not re.fullmatch("[RL][AP][SI]", sides) or "none" in directions:
        spacing = _numbers(fields.get("spacings", "1 1 1"))
        return LabelMap(values, np.diag([*spacing, 1.0]), "it has no space directions")
    units = re.findall('"(.*?)"', fields.get("space units", "")) or ["mm"]
    signs = np.array([1.0 if side in "RAS" else -1.0 for side in sides])
    origin = fields.get("space origin", "0 0 0")
    return LabelMap(values, _affine(_numbers(directions), origin, _MILLIMETRES[units[0]] * signs))


def _read_meta_image(path: Path) -> LabelMap:
    with open_regular(path) as file:
        content = file.read(_LARGEST_HEADER)
        head, key, rest = content.partition(b"ElementDataFile")
        if not key:
            raise ValueError("it has no ElementDataFile")
        line, _, data = rest.partition(b"\n")
        fields = _fields(head, "=")

        def first(names: str, default: str = "") -> str:
            """Return the first entry that is there."""
            return next((fields[name] for name in names.split() if name in fields), default)

        kind = fields["elementtype"].lower().removeprefix("met_").replace("_", "")
        encoding = "zlib" if first("compresseddata").lower() == "true" else "raw"
        most = _most_bytes(kind, fields["dimsize"], encoding)
        name = line.decode().strip(" =\r")
        if name.upper() == "LOCAL":
            file.seek(len(content) - len(data))
            data = file.read(most)
        else:
            data = _data_file(path, name, most)
    is_big = first("binarydatabyteordermsb elementbyteordermsb").lower() == "true"
    values = _voxels(data, kind, fields["dimsize"], encoding, is_big)
    spacing = np.array(_numbers(fields.get("elementspacing", "1 1 1")))
    matrix = _numbers(first("transformmatrix rotation orientation"))
    if not matrix:
        return LabelMap(values, np.diag([*spacing, 1.0]), "it has no TransformMatrix")
    directions = np.reshape(matrix, (3, 3)) * spacing[:, None]
    origin = first("offset position origin", "0 0 0")
    return LabelMap(values, _affine(directions, origin, np.array([-1.0, -1.0, 1.0])))


def _check_size(shape: tuple[int, ...]) -> None:
    """Refuse no voxels, and more than any map of a knee has, before they are read."""
    if min(shape, default=0) < 1 or math.prod(shape) > _MOST_VOXELS:
        raise ValueError(f"it has {' x '.join(map(str, shape))} voxels; crop it to the knee")


def _check_kind(shape: tuple[int, ...], dtype: np.dtype[Any]) -> None:
    """Refuse voxels that are no numbers in three dimensions."""
    if len(shape) < 3 or set(shape[3:]) - {1} or dtype.kind not in "biuf":
        raise ValueError(
            f"its voxels have the shape {shape} and the type {dtype}; a map of numbers in three dimensions is needed"
        )


def _most_bytes(kind: str, sizes: str, encoding: str) -> int:
    """Return how many bytes the voxels of the given sizes may take in a file.

    Raises:
        ValueError: there are more voxels than any map of a knee has, or too many for a text.
    """
    shape = _shape(sizes)
    _check_size(shape)
    count = math.prod(shape)
    if encoding not in _TEXTS:
        size = _dtype(kind).itemsize * count
        return size + size // 64 + _LARGEST_HEADER  # packed, random numbers take more
    if count > _MOST_IN_TEXT:
        raise ValueError(f"it has {count} voxels as text; write them raw or gzip")
    return _LONGEST * count


def _data_file(header: Path, name: str, most: int) -> bytes:
    """Read the file beside a header that this names, up to a number of bytes.

    A header of strangers names no file elsewhere: what is in it would be told as labels.
    """
    path = header.parent / name
    if path.resolve().parent != header.parent.resolve():
        raise ValueError(f"it names {name}, and may name only a file beside it")
    with open_regular(path) as file:
        return file.read(most)


def _fields(head: bytes, mark: str) -> dict[str, str]:
    """Return the entries of a header by lower-case names."""
    lines = head[:_LARGEST_HEADER].decode("latin-1").splitlines()
    pairs = (line.partition(mark) for line in lines if mark in line)
    return {key.strip().lower(): value.strip(" =") for key, _, value in pairs}


def _affine(directions: Any, origin: str, turn: Floats) -> Floats:
    """Return the affine from directions of the voxels' axes and an origin, both scaled and turned by `turn`."""
    affine = np.eye(4)
    affine[:3, :3] = np.reshape(directions, (3, 3)).T
    affine[:3, 3] = _numbers(origin)
    affine[:3] *= turn[:, None]
    return affine


def _numbers(text: str) -> list[float]:
    return [float(number) for number in _NUMBER.findall(text)]


def _shape(sizes: str) -> tuple[int, ...]:
    return tuple(int(size) for size in _numbers(sizes))


def _dtype(kind: str) -> np.dtype[Any]:
    """Return the NumPy type of a type in a header."""
    for old, new in (("unsigned ", "u"), ("signed ", "")):
        kind = kind.replace(old, new)
    kind = kind.removesuffix(" int").removesuffix("_t")
    dtype = np.dtype(_NUMPY_TYPES.get(kind, kind.replace(" ", "")))
    if dtype.kind not in "biuf" or dtype.itemsize > 8:
        raise ValueError(f"its voxels have the type {dtype}")
    return dtype


def _voxels(data: bytes, kind: str, sizes: str, encoding: str, is_big: bool) -> NDArray[Any]:
    """Decode the numbers of voxels, the first axis fastest."""
    dtype = _dtype(kind).newbyteorder(">" if is_big else "<")
    shape = _shape(sizes)
    count = math.prod(shape)
    if encoding in _TEXTS:
        try:
            return np.array(data.split(), dtype).reshape(shape, order="F")
        except ValueError:  # its words may come from any file that a header names
            raise ValueError(f"its data are not the {count} numbers of a text") from None
    decoded = _DECODERS[encoding](data, count * dtype.itemsize)
    if len(decoded) < count * dtype.itemsize:
        raise ValueError(f"it has {len(decoded)} of {count * dtype.itemsize} B")
    return np.frombuffer(decoded, dtype, count).reshape(shape, order="F")


LABEL_MAPS = {
    ".nii": _read_nifti,
    ".nii.gz": _read_nifti,
    ".nrrd": _read_nrrd,
    ".nhdr": _read_nrrd,
    ".mha": _read_meta_image,
    ".mhd": _read_meta_image,
}
"""Reader by the suffix of a file"""
