"""Compiling in processes of its own, ahead of use: several kinds of knee at once, and ended at once.

A signal while the compiler runs in one's own process may come when it is in a finalizer or a callback from C, where
Python drops what is raised; or leave half of what LLVM has, which crashes at the end. Here there is a process to end.
"""

from __future__ import annotations

import os
import sys
import threading
from collections.abc import Iterable
from contextlib import suppress
from multiprocessing.connection import Connection, wait

from knee_contact_ros.compiled.by_address import is_kept, kernel_of
from knee_contact_ros.compiled.choice import compiler_works
from knee_contact_ros.compiled.keeping import kernel_folder
from knee_contact_ros.compiled.kernel_folder import DoubtError, KernelFolder
from knee_contact_ros.compiled.layout import kind_of
from knee_contact_ros.core.scene import Scene
from knee_contact_ros.system.processes import Process, connected


def compile_ahead(scenes: Iterable[Scene]) -> None:
    """Have what is not kept for kinds of scene compiled and kept, as many at once as there are processors.

    What cannot be kept, or fails, is left to whoever uses it: there it is told. An exception meanwhile, Ctrl-C's for
    instance, ends the processes.
    """
    missing = {kind_of(scene): scene for scene in scenes if not is_kept(scene, only_on_disk=True)}
    possible = missing and compiler_works() and _can_keep()
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
    """Whether there is a folder to keep something in, as far as can be seen beforehand."""
    try:
        unlock = KernelFolder(kernel_folder()).lock("ahead")
    except (OSError, DoubtError, RuntimeError):
        return False
    if unlock:
        unlock()
    return True


def main() -> None:
    """Compile for the scene that comes through the socket that the command line names; end with who has sent it."""
    with Connection(int(sys.argv[1])) as connection:
        try:
            scene = connection.recv()
        except Exception:  # nobody is there any more, or it is of a module that only its sender has
            return
        threading.Thread(target=_end_with, args=[connection], daemon=True).start()
        kernel_of(scene, kind_of(scene))


def _end_with(connection: Connection) -> None:
    """Wait for the other end of a socket to be closed, and end this process."""
    with suppress(EOFError, OSError):
        connection.recv()
    os._exit(1)


if __name__ == "__main__":
    main()
