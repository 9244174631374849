"""Processes of others: whether they have ended, their sockets, and small disks that they fill."""

import shutil
import subprocess

import psutil

NO_BYTECODE = {"PYTHONDONTWRITEBYTECODE": "1"}
"""Environment of a Python that may write no large file: it would leave modules' bytecode cut off for all after it"""


def has_ended(process):
    """Whether it works no more; one whose parent is gone is a zombie until the system takes note."""
    try:
        return not process.is_running() or process.status() == psutil.STATUS_ZOMBIE
    except psutil.NoSuchProcess:
        return True


def internet_sockets(process):
    """Its sockets of the internet; psutil before 6, as in Ubuntu 24.04, has another name for them."""
    ask = process.net_connections if hasattr(process, "net_connections") else process.connections
    return list(ask(kind="inet"))


def remount(folder, how):
    """Change how a file system may be used."""
    subprocess.run([shutil.which("mount") or "", "-o", f"remount,{how}", str(folder)], check=True)
