"""The file behind a pipe: whole, and with an error that its writer never meets."""

from __future__ import annotations

import errno
import io
import os
import resource
import subprocess
import sys
from pathlib import Path

import pytest

from knee_contact_ros.offline.solve import solve
from knee_contact_ros.parameters.reading import load_parameters
from knee_contact_ros.view.piped import BLOCK, PipedFile
from tests.helpers.needs import needs_viewer
from tests.helpers.processes import NO_BYTECODE


def test_all_that_comes_is_in_the_file(tmp_path: Path) -> None:
    path, data = tmp_path / "whole", os.urandom(5 * BLOCK + 17)
    piped = PipedFile(path.open("wb"))
    with piped.name.open("wb", buffering=0) as writer:
        piped.begin()
        for start in range(0, len(data), 1000):
            writer.write(data[start : start + 1000])
    piped.close()
    assert path.read_bytes() == data


def test_a_full_disk_is_told_and_holds_no_writer() -> None:
    piped = PipedFile(Path("/dev/full").open("wb"))  # noqa: SIM115  (it closes it)
    with piped.name.open("wb") as writer:
        piped.begin()
        for _ in range(5):
            writer.write(bytes(BLOCK))
    with pytest.raises(OSError, match="No space left") as told:
        piped.close()
    assert (told.value.errno, told.value.filename) == (errno.ENOSPC, "/dev/full")


def test_a_disk_that_tells_at_the_end_is_told(tmp_path: Path) -> None:
    class Late(io.FileIO):
        def close(self) -> None:
            super().close()
            raise OSError(errno.EDQUOT, "Disk quota exceeded")

    path = tmp_path / "whole"
    piped = PipedFile(Late(path, "w"))
    with piped.name.open("wb") as writer:
        piped.begin()
        writer.write(b"knee")
    with pytest.raises(OSError, match="quota") as told:
        piped.close()
    assert told.value.filename == path


@pytest.fixture(scope="module")
def recording(right_bag: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("recording") / "answers.mcap"
    solve(right_bag, load_parameters({}), path, lambda *_: None)
    return path


@needs_viewer
@pytest.mark.parametrize("size", [1000, 300_000])  # in the blueprint, in the scene
def test_view_ends_with_one_line_when_the_disk_is_full(recording: Path, tmp_path: Path, size: int) -> None:
    path = tmp_path / "pictures" / "knee.rrd"
    path.parent.mkdir()
    done = subprocess.run(
        [sys.executable, "-m", "knee_contact_ros.cli.main", "view", str(recording), "--save", str(path)],
        capture_output=True, text=True, timeout=180, check=False, env=os.environ | NO_BYTECODE,
        preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_FSIZE, (size, size)),
    )  # fmt: skip
    assert done.stderr.splitlines()[-1] == f"knee-contact: {path}.partial: File too large"
    assert done.returncode == 1
    assert not list(path.parent.iterdir())
