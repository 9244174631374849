"""What is kept of compiled functions can only help: whatever is odd about it costs one line and a compilation.

The function here takes no time to compile; `tests/ros/test_kernel_cache.py` has the real kernel.
"""

from __future__ import annotations

import os
import shutil
import stat
import subprocess
import sys
import time
from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import pytest

from knee_contact_ros.compiled import keeping
from knee_contact_ros.compiled.kernel_folder import HEAD, KEPT, UNUSED, DoubtError, KernelFolder
from tests.helpers.tiny_kernel import FORKS, Outcome, begin, use, use_all, use_own

pytestmark = pytest.mark.xdist_group("tiny kernel")  # one process, so that one compiler is made ready
COMPILED, LOADED = Outcome(42.0, False, []), Outcome(42.0, True, [])
NOBODY = 65534


def only(folder: Path) -> Path:
    """What a folder holds."""
    (path,) = folder.iterdir()
    return path


def kernel(home: Path) -> Path:
    """The one kernel that is kept."""
    return only(folder_of_kernels(home / "knee_contact_ros"))


def folder_of_kernels(ours: Path) -> Path:
    """The one that is there."""
    (path,) = ours.glob("kernel-*")
    return path


def change(edit: Callable[[bytes], bytes]) -> Callable[[Path], object]:
    """Other bytes in a file."""
    return lambda path: path.write_bytes(edit(path.read_bytes()))


def flip(place: float) -> Callable[[Path], object]:
    """One bit changed, at a share of the file's length."""

    def flipped(data: bytes) -> bytes:
        at = int(place * (len(data) - 1))
        return data[:at] + bytes([data[at] ^ 1]) + data[at + 1 :]

    return change(flipped)


def instead(make: Callable[[Path], object]) -> Callable[[Path], object]:
    """Something else under the name of a file or folder."""

    def changed(path: Path) -> None:
        path.rename(path.parent.parent / "elsewhere")
        make(path)

    return changed


def foreign(path: Path) -> None:
    if os.geteuid():
        pytest.skip("only root may give files away")
    os.chown(path, NOBODY, NOBODY)


def locked(path: Path) -> None:
    path.chmod(0)
    if os.access(path, os.R_OK):
        pytest.skip("this user may read everything")


def kernel_of_another(path: Path) -> None:
    """A whole kernel of this very model, for other arguments."""
    use(path.parent.parent.parent, 21)
    (other,) = set(path.parent.iterdir()) - {path}
    other.replace(path)


WRITABLE, FOREIGN = "can be written by other users (chmod go-w makes it ours)", "belongs to another user"
DAMAGED = "is damaged"
FILES: dict[str, tuple[Callable[[Path], object], str]] = {
    "empty": (change(lambda data: b""), DAMAGED),
    "cut off in its digest": (change(lambda data: data[: len(HEAD) + 5]), DAMAGED),
    "cut in half": (change(lambda data: data[: len(data) // 2]), DAMAGED),
    "all zeros": (change(lambda data: bytes(len(data))), DAMAGED),
    "longer": (change(lambda data: data + b"\0"), DAMAGED),
    "a bit of the first byte": (flip(0.0), DAMAGED),
    "a bit of the digest": (flip((len(HEAD) + 3) / 11000), DAMAGED),
    "a bit of the code": (flip(0.5), DAMAGED),
    "a bit of the last byte": (flip(1.0), DAMAGED),
    "huge": (lambda path: os.truncate(path, 1 << 40), DAMAGED),
    "a kernel for other arguments": (kernel_of_another, DAMAGED),
    "a folder": (instead(Path.mkdir), "is no file"),
    "a pipe": (instead(os.mkfifo), "is no file"),
    "a link": (
        instead(lambda path: path.symlink_to(path.parent.parent / "elsewhere")),
        "cannot be read: Too many levels of symbolic links",
    ),
    "locked": (locked, "cannot be read: Permission denied"),
    "writable by a group": (lambda path: path.chmod(0o660), WRITABLE),
    "writable by all": (lambda path: path.chmod(0o606), WRITABLE),
    "foreign": (foreign, FOREIGN),
}
FOLDERS: dict[str, tuple[Callable[[Path], object], str]] = {
    "a file": (instead(Path.touch), "is no folder"),
    "a link": (instead(lambda path: path.symlink_to(path.parent.parent / "elsewhere")), "is no folder"),
    "writable by a group": (lambda path: path.chmod(0o770), WRITABLE),
    "writable by all": (lambda path: path.chmod(0o1777), WRITABLE),
    "foreign": (foreign, FOREIGN),
}


@pytest.fixture(scope="module")
def warm(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A cache with the function."""
    home = tmp_path_factory.mktemp("cache")
    assert use(home) == COMPILED
    assert use(home) == LOADED
    return home


@pytest.fixture
def home(warm: Path, tmp_path: Path) -> Path:
    """A copy of it."""
    return shutil.copytree(warm, tmp_path / "home")


def assert_said(outcome: Outcome, place: Path, words: str) -> None:
    """The right answer, after compiling, and one line."""
    assert outcome[:2] == COMPILED[:2]
    (line,) = outcome.said
    assert line.startswith(f"knee_contact_ros: compiled code: {place} {words}; ")


@pytest.mark.parametrize("name", FILES)
def test_a_file_that_is_odd_is_told_and_made_again(home: Path, name: str) -> None:
    damage, words = FILES[name]
    path = kernel(home)
    damage(path)
    assert_said(use(home), path, words)
    assert use(home) == LOADED
    assert not list(path.parent.glob(".*"))


@pytest.mark.parametrize("name", FOLDERS)
def test_a_folder_that_is_odd_is_told_and_left_alone(home: Path, name: str) -> None:
    damage, words = FOLDERS[name]
    folder = kernel(home).parent
    damage(folder)
    before = sorted(home.rglob("*"))
    for _ in range(2):
        assert_said(use(home), folder, words)
    assert sorted(home.rglob("*")) == before


@pytest.mark.parametrize("name", ["a file", "writable by all", "foreign"])
def test_the_folder_above_counts_too(home: Path, name: str) -> None:
    damage, words = FOLDERS[name]
    above = home / "knee_contact_ros"
    folder = folder_of_kernels(above)
    damage(above)
    place, words = (folder, "is no folder") if name == "a file" else (above, words)
    assert_said(use(home), place, words)


def test_a_folder_above_that_a_group_can_write_does_no_harm(home: Path) -> None:
    (home / "knee_contact_ros").chmod(0o775)
    assert use(home) == LOADED


def test_a_full_folder_in_the_place_of_a_file_stays(home: Path) -> None:
    path = kernel(home)
    path.unlink()
    path.mkdir()
    (path / "something").touch()
    for _ in range(2):
        assert_said(use(home), path, "is no file")


def test_what_cannot_be_kept_is_compiled_all_the_same(warm: Path, tmp_path: Path) -> None:
    name = kernel(warm).relative_to(warm)
    (tmp_path / "file").touch()
    path = tmp_path / "file" / "home" / name
    assert_said(use(tmp_path / "file" / "home"), path, "cannot be read: Not a directory")
    full = tmp_path / "full"
    assert_said(use(full, largest_file=4096), full / name, "cannot be written: File too large")
    assert not list((full / name).parent.iterdir())
    assert use(full) == COMPILED


def test_a_cache_that_cannot_be_written_is_read(home: Path) -> None:
    path = kernel(home)
    path.parent.chmod(0o500)
    if os.access(path.parent, os.W_OK):
        pytest.skip("this user may write everything")
    assert use(home) == LOADED
    answer, loaded, (line,) = use(home, 21j)
    assert (answer, loaded) == (42j, False)
    assert line.endswith("cannot be written: Permission denied; what was compiled is not kept")


def test_another_processor_has_kernels_of_its_own(home: Path) -> None:
    folder = kernel(home).parent
    code = f"from tests.helpers.tiny_kernel import *; print(*alone(Path({str(home)!r}), twice, 21.0))"
    plain = os.environ | {"NUMBA_CPU_NAME": "generic", "NUMBA_CPU_FEATURES": ""}
    said = subprocess.run([sys.executable, "-c", code], env=plain, capture_output=True, text=True, check=True).stdout
    assert said.startswith("42.0 False")
    assert f"{folder} is from another processor; compiling again" in said
    assert len(list(folder.iterdir())) == 2
    assert use(home) == LOADED


def test_only_an_absolute_cache_home_counts(tmp_path: Path) -> None:
    assert use(Path("here"), HOME=str(tmp_path)) == COMPILED
    assert use(tmp_path / ".cache") == LOADED


def test_what_is_kept_is_for_its_user_alone(home: Path) -> None:
    modes = {path.name: stat.S_IMODE(path.stat().st_mode) for path in (home / "knee_contact_ros").rglob("*")}
    assert modes == {kernel(home).parent.name: 0o700, kernel(home).name: 0o600, "meaning": 0o700, "model": 0o600}


def test_processes_that_compile_at_once_keep_what_all_have_compiled(tmp_path: Path) -> None:
    values: list[Any] = [21.0, 21.0, 21, 21j]
    with ExitStack() as stack:
        begun = [begin(stack, tmp_path, value) for value in values]
        outcomes = [one.result() for one in begun]
    assert [(outcome.answer, outcome.said) for outcome in outcomes] == [(2 * value, []) for value in values]
    assert [use(tmp_path, value) for value in values] == [Outcome(2 * value, True, []) for value in values]
    assert len(list(folder_of_kernels(tmp_path / "knee_contact_ros").iterdir())) == 3


OWN = """
from __future__ import annotations
from typing import NamedTuple
from numbers_of_mine import SLOPE

class Own(NamedTuple):
    stiffness: float

    def force_at(self, depth: float, rate: float, impact_speed: float) -> tuple[float, float, float]:
        return self.stiffness * depth * SLOPE{more}, SLOPE, 0.0

def ask(law):
    return law.force_at(1.0, 0.0, 0.0)[0]
"""


def test_a_law_of_the_users_is_compiled_again_when_he_changes_it(tmp_path: Path) -> None:
    home = tmp_path / "home"

    def write(more: str, slope: str) -> None:
        (tmp_path / "own.py").write_text(OWN.format(more=more))
        (tmp_path / "numbers_of_mine.py").write_text(f"SLOPE = {slope}")

    write("", "3.0")
    assert use_own(home, tmp_path) == Outcome(6.0, False, [])
    assert use_own(home, tmp_path) == Outcome(6.0, True, [])
    write(" + 1.0", "3.0")
    assert use_own(home, tmp_path) == Outcome(7.0, False, [])
    write(" + 1.0", "30.0")
    assert use_own(home, tmp_path) == Outcome(61.0, False, [])


def test_an_edit_of_the_model_counts_and_one_of_the_keeping_does_not(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    counting = ("CORE/ticks.py", "CORE/contact_laws/hertz.py", "COMPILED/inner.py", "COMPILED/functions.py")
    for name in (
        *counting,
        *(f"COMPILED/{name}" for name in keeping.KEEPING),
    ):  # a few: to parse all takes most of a second
        folder, _, file = name.partition("/")
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        shutil.copy(getattr(keeping, folder) / file, tmp_path / name)
    for name in ("CORE", "COMPILED"):
        monkeypatch.setattr(keeping, name, tmp_path / name)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "caches"))
    meaning = keeping.model_meaning.__wrapped__
    before = meaning()
    assert meaning() == before
    for name in keeping.KEEPING:
        (tmp_path / "COMPILED" / name).write_text("edited = True")
    assert meaning() == before
    for name in counting:
        path = tmp_path / name
        path.write_text("# edited\n\n" + path.read_text().replace('"""', '"""Other words. ', 1))
        assert meaning() == before
        path.write_text(path.read_text() + "edited = True\n")
        assert meaning() != before
        before = meaning()


def test_a_damaged_note_of_a_meaning_is_made_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    monkeypatch.setattr(keeping, "CORE", keeping.CORE / "contact_laws")  # a few files: to parse all takes long
    meaning = keeping.model_meaning.__wrapped__
    right = meaning()
    (note,) = (tmp_path / "knee_contact_ros" / "meaning").iterdir()
    whole = note.read_bytes()
    for content in (b"", whole[:-1], whole + b"x"):
        note.write_bytes(content)
        assert meaning() == right
        assert note.read_bytes() == whole


def keep_on_writing(path: Path) -> None:
    while True:
        for number in range(2):
            KernelFolder(path).write("a", bytes([number]) * 1_000_000)


def test_a_file_is_whole_while_it_is_written_and_after_a_kill(tmp_path: Path) -> None:
    """Also under writers that are killed at any moment; what they leave goes when it is old."""
    folder = KernelFolder(tmp_path / "above" / "kernel-x")
    seen = set()
    for _ in range(5):
        writers = [FORKS.Process(target=keep_on_writing, args=(folder.path,)) for _ in range(2)]
        for writer in writers:
            writer.start()
        end = time.monotonic() + 20.0
        while len(seen) < 2 or writers[0].exitcode is None:
            content = folder.read("a")
            seen.add(content and content[0])
            assert content is None or content == content[:1] * 1_000_000
            if {0, 1} <= seen or time.monotonic() > end:
                break
        for writer in writers:
            writer.kill()
            writer.join()
        assert folder.read("a")
    for part in folder.path.glob(".*"):
        os.utime(part, (0, 0))
    folder.remove_unused()
    assert [path.name for path in folder.path.iterdir()] == ["a"]


def test_a_kernel_under_the_name_of_another_model_is_damage(tmp_path: Path) -> None:
    KernelFolder(tmp_path / "kernel-1").write("a", b"machine code")
    (tmp_path / "kernel-1").rename(tmp_path / "kernel-2")
    with pytest.raises(DoubtError, match="kernel-2/a is damaged"):
        KernelFolder(tmp_path / "kernel-2").read("a")


def test_folders_that_nobody_uses_go(tmp_path: Path) -> None:
    """The newest stay however old they are; what was read lately is not old."""
    old, now = time.time() - UNUSED - 60.0, time.time()
    folders = [KernelFolder(tmp_path / f"kernel-{number:02}") for number in range(20)]
    for number, folder in enumerate(folders):
        folder.write("a", b"machine code")
        for path in (folder.path / "a", folder.path):
            os.utime(path, (now, old + number if number < 15 else now))
    (tmp_path / "kernel-away").symlink_to(tmp_path / "reference", target_is_directory=True)
    for other in ("reference", "kernel.txt"):
        (tmp_path / other).mkdir()
        os.utime(tmp_path / other, (old, old))
    folders[3].read("a")
    folders[0].remove_unused()
    left = {path.name for path in tmp_path.iterdir()}
    newest = [0, 3, *range(20 - KEPT + 2, 20)]
    assert left == {f"kernel-{number:02}" for number in newest} | {"reference", "kernel-away", "kernel.txt"}
    many = [KernelFolder(tmp_path / f"kernel-new{number:02}") for number in range(20)]
    for folder in many:
        folder.write("a", b"machine code")
    many[0].remove_unused()
    assert all(folder.read("a") for folder in many)


def test_that_nothing_can_be_kept_is_said_once(tmp_path: Path) -> None:
    """Whatever the reason: a home that cannot be written is one, a full disk another."""
    answers, loaded, (line,) = use_all(tmp_path, [21.0, 21, 21j], largest_file=4096)
    assert (answers, loaded) == ([42.0, 42, 42j], False)
    assert line.endswith("cannot be written: File too large; what was compiled is not kept")


def test_what_the_administrator_has_kept_serves_all_users(tmp_path: Path) -> None:
    """As in the image of a robot: compiled as root, read by others, who cannot change it."""
    if os.geteuid():
        pytest.skip("only root may become another user")
    with TemporaryDirectory(dir="/tmp") as place:
        folder = KernelFolder(Path(place) / "above" / "kernel-x")
        folder.write("a", b"kernel")
        subprocess.run(["/bin/chmod", "-R", "a+rX", place], check=True)
        child = os.fork()
        if not child:
            os.setuid(NOBODY)
            os._exit(0 if folder.read("a") == b"kernel" else 1)
        assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == 0
