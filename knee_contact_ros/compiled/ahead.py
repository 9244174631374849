"""Compiling ahead of use, in processes of its own: several kinds of knee at once, which can be ended at any time.

A signal in a process that compiles may come during a finalizer or a callback from C, where Python drops the exception;
or it leaves LLVM's objects half made, which crashes at the end of the process. A process of its own can just be killed.
"""

from __future__ import annotations

import os
import sys
import threading
from collections.abc import Iterable
from contextlib import suppress
from multiprocessing.connection import Connection, wait

from knee_contact_ros.compiled.choice import compiler_works
from knee_contact_ros.compiled.keeping import kernel_folder
from knee_contact_ros.compiled.kernel import is_kept, kernel_of
from knee_contact_ros.compiled.kernel_folder import DoubtError, KernelFolder
from knee_contact_ros.compiled.layout import kind_of
from knee_contact_ros.compiled.shipped import is_there
from knee_contact_ros.core.scene import Scene
from knee_contact_ros.system.processes import Process, connected


def compile_ahead(scenes: Iterable[Scene]) -> None:
    """Compile and keep the kernels for kinds of scene that are not kept yet, as many at once as there are processors.

    A kernel that fails, or cannot be kept, is left to its first use, which reports the problem. An exception meanwhile,
    that of Ctrl-C for instance, ends the processes.
    """
    missing = {kind_of(scene): scene for scene in scenes if not is_kept(scene, only_on_disk=True)}
    possible = missing and _can_keep() and (all(map(is_there, missing)) or compiler_works())
    waiting, running = list(missing.values()) if possible else [], dict[Connection, Process]()
    try:
        while waiting or running:
            while waiting and len(running) < len(os.sched_getaffinity(0)):
                connection, process = connected(__name__)
                running[connection] = process
                with suppress(OSError):  # it may be gone
                    connection.send(waiting.pop())
            for ended in wait(list(running)):
                running.pop(ended).wait()  # type: ignore[call-overload]
    finally:
        for process in running.values():
            process.kill()
            process.wait()


def _can_keep() -> bool:
    """Whether there seems to be a folder in which kernels can be kept."""
    try:
        unlock = KernelFolder(kernel_folder()).lock("ahead")
    except (OSError, DoubtError, RuntimeError):
        return False
    if unlock:
        unlock()
    return True


def main() -> None:
    """Compile for the scene that comes through the socket named in the command line; end when its sender ends."""
    with Connection(int(sys.argv[1])) as connection:
        try:
            scene = connection.recv()
        except Exception:  # nobody is there any more, or it is of a module that only its sender has
            return
        threading.Thread(target=_end_with, args=[connection], daemon=True).start()
        kernel_of(scene, kind_of(scene))


def _end_with(connection: Connection) -> None:
    """Wait until the other end of a socket is closed, and end this process."""
    with suppress(EOFError, OSError):
        connection.recv()
    os._exit(1)


if __name__ == "__main__":
    main()
