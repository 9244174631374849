"""Damages to bags."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from random import Random

MOST_FLIPS = 8
LONGEST_RUN = 64
"""Length of the longest run of bytes [B]"""
LONGEST_RANGE = 0.3
"""Largest part of a file that a range covers"""


def bit_flips(data: bytearray, random: Random) -> None:
    """Flip a few bits anywhere."""
    for _ in range(random.randint(1, MOST_FLIPS)):
        data[random.randrange(len(data))] ^= 1 << random.randrange(8)


def truncation(data: bytearray, random: Random) -> None:
    """Cut off the end."""
    del data[random.randrange(len(data)) :]


def byte_run(data: bytearray, random: Random) -> None:
    """Overwrite some bytes with zeros, ones or noise."""
    begin, length = random.randrange(len(data)), random.randint(1, LONGEST_RUN)
    length = min(length, len(data) - begin)
    filler = random.choice((bytes(length), b"\xff" * length, random.randbytes(length)))
    data[begin : begin + length] = filler


def duplicated_range(data: bytearray, random: Random) -> None:
    """Duplicate some bytes."""
    begin, end = _range(data, random)
    data[end:end] = data[begin:end]


def deleted_range(data: bytearray, random: Random) -> None:
    """Delete some bytes."""
    begin, end = _range(data, random)
    del data[begin:end]


def zeroed_end(data: bytearray, random: Random) -> None:
    """Overwrite the end with zeros, as after a power cut."""
    begin = random.randrange(len(data))
    data[begin:] = bytes(len(data) - begin)


def _range(data: bytearray, random: Random) -> tuple[int, int]:
    begin = random.randrange(len(data))
    return begin, min(len(data), begin + random.randint(1, max(1, int(LONGEST_RANGE * len(data)))))


ON_BYTES: Mapping[str, Callable[[bytearray, Random], None]] = {
    "bit flips": bit_flips,
    "truncation": truncation,
    "byte run": byte_run,
    "duplicated range": duplicated_range,
    "deleted range": deleted_range,
    "zeroed end": zeroed_end,
}


def deleted_line(text: list[str], random: Random) -> None:
    """Delete a line of `metadata.yaml`."""
    del text[random.randrange(len(text))]


def changed_number(text: list[str], random: Random) -> None:
    """Change a digit in `metadata.yaml`."""
    digits = [(row, column) for row, line in enumerate(text) for column, sign in enumerate(line) if sign.isdigit()]
    row, column = random.choice(digits)
    text[row] = text[row][:column] + str(random.randrange(10)) + text[row][column + 1 :]


def changed_word(text: list[str], random: Random) -> None:
    """Change a letter in `metadata.yaml`."""
    row = random.choice([row for row, line in enumerate(text) if line.strip()])
    column = random.randrange(len(text[row]))
    text[row] = text[row][:column] + random.choice("aeiou:- ") + text[row][column + 1 :]


def swapped_lines(text: list[str], random: Random) -> None:
    """Swap two lines of `metadata.yaml`."""
    one, other = random.randrange(len(text)), random.randrange(len(text))
    text[one], text[other] = text[other], text[one]


ON_METADATA: Mapping[str, Callable[[list[str], Random], None]] = {
    "metadata.yaml: deleted line": deleted_line,
    "metadata.yaml: changed number": changed_number,
    "metadata.yaml: changed letter": changed_word,
    "metadata.yaml: swapped lines": swapped_lines,
}


def mutate(bag: Path, random: Random) -> str:
    """Damage a bag, and return the name of the damage."""
    if not bag.is_dir():
        return _on_bytes(bag, random)
    files = sorted(path for path in bag.iterdir() if path.suffix != ".yaml")
    fate = random.random()
    if fate < 0.6:
        return _on_bytes(random.choice(files), random)
    metadata = bag / "metadata.yaml"
    if fate < 0.7:
        _on_bytes(metadata, random)
        return "metadata.yaml: bytes"
    if fate < 0.95:
        name = random.choice(list(ON_METADATA))
        text = metadata.read_text(encoding="utf-8").splitlines()
        ON_METADATA[name](text, random)
        metadata.write_text("\n".join(text) + "\n", encoding="utf-8")
        return name
    random.choice([*files, metadata]).unlink()
    return "missing file"


def _on_bytes(path: Path, random: Random) -> str:
    name = random.choice(list(ON_BYTES))
    data = bytearray(path.read_bytes())
    ON_BYTES[name](data, random)
    path.write_bytes(data)
    return name
