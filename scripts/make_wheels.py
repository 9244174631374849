"""Make wheels for all systems on one Linux machine, and a plain one without the compiled model.

    python -m scripts.make_wheels [OUTPUT]

The modules are packed once. Numba translates the model, LLVM makes an object for each target, and Zig links it.
`tests/packaging/check_wheels.py` runs what a Linux machine can run, and looks into the others.
"""

from __future__ import annotations

import base64
import csv
import hashlib
import io
import subprocess
import sys
import tempfile
from copy import copy
from pathlib import Path
from zipfile import ZIP_DEFLATED, ZipFile

from knee_contact_ros.model.compiler import TARGETS, build
from knee_contact_ros.model.kernel import digest_of_sources, portable_code

ROOT = Path(__file__).resolve().parents[1]
TAGS = {
    "x86-64": "manylinux_2_17_x86_64",
    "aarch64": "manylinux_2_17_aarch64",
    "macos-arm64": "macosx_11_0_arm64",
    "macos-x86-64": "macosx_11_0_x86_64",
    "windows-x86-64": "win_amd64",
}
"""Platform of a wheel by target; its version is that of the target's linker"""


def plain_wheel(folder: Path) -> Path:
    """Make the wheel without a library, for any machine, in a folder."""
    options = ["--quiet", "--no-deps", "--config-settings", "library=no", "--wheel-dir", folder]
    subprocess.run([sys.executable, "-m", "pip", "wheel", *options, ROOT], check=True)
    (wheel,) = folder.glob("*-py3-none-any.whl")
    return wheel


def wheel_with(library: Path, plain: Path, tag: str) -> Path:
    """Return a copy of the plain wheel with a library beside the model, for a platform."""
    made = plain.with_name(plain.name.replace("none-any", f"none-{tag}"))
    with ZipFile(plain) as source, ZipFile(made, "w", ZIP_DEFLATED) as target:
        infos = {each.filename: each for each in source.infolist()}
        contents = {name: source.read(name) for name in infos}
        (record,) = (name for name in contents if name.endswith(".dist-info/RECORD"))
        about = record.replace("RECORD", "WHEEL")
        text = contents[about].decode().replace("Tag: py3-none-any", f"Tag: py3-none-{tag}")
        contents[about] = text.replace("Purelib: true", "Purelib: false").encode()
        added = f"knee_contact_ros/model/{library.name}"
        infos[added] = copy(infos["knee_contact_ros/__init__.py"])
        infos[added].filename = added
        contents[added] = library.read_bytes()
        contents[record] = _record(contents, record).encode()
        for name, content in contents.items():
            target.writestr(infos[name], content)
    return made


def _record(contents: dict[str, bytes], record: str) -> str:
    """Return the list of a wheel's files with their digests and sizes, as installers check it."""
    text = io.StringIO()
    lines = csv.writer(text, lineterminator="\n")
    for name, content in contents.items():
        if name == record:
            lines.writerow([record, "", ""])
            continue
        digest = base64.urlsafe_b64encode(hashlib.sha256(content).digest()).rstrip(b"=").decode()
        lines.writerow([name, f"sha256={digest}", len(content)])
    return text.getvalue()


def make_wheels(output: Path) -> list[Path]:
    """Make all wheels in a folder; return them, the plain one first."""
    output.mkdir(parents=True, exist_ok=True)
    plain = plain_wheel(output)
    wheels = [plain]
    for name, tag in TAGS.items():
        target = TARGETS[name]
        with tempfile.TemporaryDirectory() as folder:
            library = Path(folder, f"knee_contact-{digest_of_sources()}{target.suffix}")
            build(portable_code(), target, library, portable=True)
            wheels.append(wheel_with(library, plain, tag))
    return wheels


if __name__ == "__main__":
    for wheel in make_wheels(Path(sys.argv[1] if len(sys.argv) > 1 else "dist")):
        print(f"{wheel}  {wheel.stat().st_size / 1e6:.1f} MB")
