"""Unfinished files: who writes them, and which were cut off."""

import errno
import os
import re
import signal
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

from knee_contact_ros.system.errors import IncompleteError, UsageError
from knee_contact_ros.system.output_files import (
    check_name_free,
    check_writable,
    claim,
    claim_first,
    expand_stamp,
    free_names,
    is_being_written,
    take_name,
    unfinished_files,
    work_folder,
    write_complete,
)

WRITER = """
import sys, time
from pathlib import Path
from knee_contact_ros.system.output_files import claim
file = claim(Path(sys.argv[1]))
print("open", flush=True)
time.sleep(60.0)
"""


def test_a_file_is_being_written_as_long_as_its_writer_lives(tmp_path):
    path, partial = tmp_path / "out.mcap", tmp_path / "out.mcap.partial"
    with subprocess.Popen(
        [sys.executable, "-c", WRITER, path], stdout=subprocess.PIPE, text=True
    ) as writer:
        assert writer.stdout
        assert writer.stdout.readline() == "open\n"
        assert is_being_written(partial)
        assert unfinished_files(tmp_path, ".mcap") == []
        with pytest.raises(UsageError, match="is being written by another process"):
            check_name_free(path)
        os.kill(writer.pid, signal.SIGKILL)
        writer.wait()
    assert not is_being_written(partial)
    assert unfinished_files(tmp_path, ".mcap") == [partial]
    with pytest.raises(UsageError, match="was cut off"):
        check_name_free(path)


PLANTED: dict[str, Callable[[Path], None]] = {
    "a link": lambda place: place.symlink_to(place.parent / "victim"),
    "a pipe": os.mkfifo,
}
"""What may lie where a file is to be, and must not be opened: a link leads elsewhere, a pipe is waited for"""


@pytest.mark.parametrize("what", PLANTED)
@pytest.mark.parametrize("place", ["out.mcap", "out.mcap.partial"])
def test_links_and_pipes_are_never_opened(tmp_path, what, place):
    path, victim = tmp_path / "out.mcap", tmp_path / "victim"
    victim.write_text("another's")
    PLANTED[what](tmp_path / place)
    assert unfinished_files(tmp_path, ".mcap") == []
    with pytest.raises(UsageError):
        claim(path)
    assert claim_first(free_names(path))[0].name == "out_1.mcap"
    with claim(path, overwrite=True) as file:
        file.write(b"ours")
        with pytest.raises(UsageError, match="is being written"):
            claim(path, overwrite=True)
    take_name(tmp_path / "out.mcap.partial", path, overwrite=True)
    assert path.read_bytes() == b"ours"
    assert not path.is_symlink()
    assert victim.read_text() == "another's"


@pytest.mark.parametrize("trouble", [0, errno.EPERM, errno.ENOTSUP])
def test_a_name_that_is_taken_meanwhile_is_left_alone(tmp_path, monkeypatch, trouble):
    """Also where a file system has no links."""

    def link(*_arguments, **_options):
        raise OSError(trouble, os.strerror(trouble))

    if trouble:
        monkeypatch.setattr("os.link", link)
    for name in ("out.mcap", "out_1.mcap"):
        (tmp_path / name).write_text(name)
    partial = tmp_path / "out.mcap.partial"
    partial.write_text("new")
    assert take_name(partial, tmp_path / "out.mcap", overwrite=False) == tmp_path / "out_2.mcap"
    contents = {path.name: path.read_text() for path in tmp_path.iterdir()}
    assert contents == {"out.mcap": "out.mcap", "out_1.mcap": "out_1.mcap", "out_2.mcap": "new"}


IMPOSSIBLE = {
    "..": "Is a directory",
    "folder": "Is a directory",
    "file/out.mcap": "Not a directory",
    f"{'n' * 250}.mcap": "File name too long",
    "new/" + "x/" * 4000 + "out.mcap": "File name too long",
    "with\0zero.mcap": "embedded null ",  # byte, or character in path
    "half\ud800.mcap": "'utf-8' codec can't encode character '\\ud800' in position",
    "loop/out.mcap": "Too many levels of symbolic links",
}


@pytest.mark.parametrize("name", IMPOSSIBLE)
def test_paths_that_cannot_be_are_refused_with_the_reason(tmp_path, name):
    (tmp_path / "folder").mkdir()
    (tmp_path / "file").touch()
    (tmp_path / "loop").symlink_to(tmp_path / "loop")
    before = sorted(tmp_path.rglob("*"))
    with pytest.raises(UsageError, match=re.escape(IMPOSSIBLE[name])):
        check_writable(tmp_path / name)
    with pytest.raises(UsageError):
        claim(tmp_path / name, overwrite=True)
    check_writable(tmp_path / "new" / "deep" / "out.mcap")
    assert sorted(tmp_path.rglob("*")) == before


@pytest.mark.parametrize("number", [errno.ENOSPC, errno.EDQUOT, errno.EFBIG])
def test_a_full_disk_is_no_bad_input_and_the_output_is_named(tmp_path, monkeypatch, number):
    def full(*_, **__):
        raise OSError(number, os.strerror(number))

    out = tmp_path / "out"
    told = f"^cannot write {re.escape(str(out))}: {os.strerror(number)}$"
    monkeypatch.setattr("os.fsync", full)
    with pytest.raises(IncompleteError, match=told):
        write_complete({out: b"result"})
    with pytest.raises(IncompleteError, match=told), work_folder(out):
        full()
    monkeypatch.setattr(Path, "mkdir", full)
    with pytest.raises(IncompleteError, match=told), work_folder(out):
        pass
    assert not any(tmp_path.iterdir())


@pytest.mark.skipif(os.geteuid() == 0, reason="a user other than root")
def test_folders_that_may_not_be_used_are_refused(tmp_path):
    for mode in (0o500, 0o600):
        tmp_path.chmod(mode)
        with pytest.raises(UsageError, match="Permission denied"):
            check_writable(tmp_path / "new" / "out.mcap")
    tmp_path.chmod(0o700)


def test_a_home_folder_and_the_time_are_put_in_their_places(
    monkeypatch,
):
    monkeypatch.setenv("HOME", "/home/anna")
    assert re.fullmatch(r"/home/anna/runs/[\d_-]{19}\.mcap", expand_stamp("~/runs/{stamp}.mcap"))
    assert expand_stamp("") == ""
