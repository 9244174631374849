"""Small disks: file systems in memory."""

from __future__ import annotations

import shutil
import subprocess
from pathlib import Path


def remount(folder: Path, how: str) -> None:
    """Change how a file system may be used."""
    subprocess.run([shutil.which("mount") or "", "-o", f"remount,{how}", str(folder)], check=True)
