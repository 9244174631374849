"""`knee-contact` for shells that starts at once: each command is forked from the process that has imported all.

What a shell starts is a small program (`CLIENT`), which hands over its arguments, folder, environment and streams,
passes signals on, and ends with the command's code.
"""

import json
import os
import signal
import socket
import sys
from contextlib import contextmanager, suppress
from importlib import import_module
from threading import Thread

from tests.helpers.forked import COMMAND, PROCESSES

MAX_REQUEST = 1 << 20
"""Largest size of a request [B]"""
CLIENT = f"""#!{sys.executable} -IS
import json, os, signal, socket, sys
door = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET)
door.connect({{path!r}})
deaf = signal.getsignal(signal.SIGINT) == signal.SIG_IGN
request = json.dumps([sys.argv[1:], os.getcwd(), dict(os.environ), deaf])
socket.send_fds(door, [request.encode()], [0, 1, 2])
pid = int(door.recv(20))
for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
    signal.signal(number, lambda number, _: os.kill(pid, number))
os._exit(int(door.recv(20) or 1))
"""


@contextmanager
def warm_commands(folder):
    """A folder for PATH, with a program `knee-contact`; all that it has started is gone afterwards."""
    program, door = folder / "programs" / "knee-contact", folder / "door"
    program.parent.mkdir()
    program.write_text(CLIENT.format(path=str(door)))
    program.chmod(0o755)
    started = []
    with socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET) as listener:
        listener.bind(str(door))
        listener.listen()
        Thread(target=serve, args=(listener, started), daemon=True).start()
        yield program.parent
        listener.shutdown(socket.SHUT_RDWR)
        for process in started:
            process.kill()
            process.join()


def serve(listener, started):
    """Fork a process for each program that knocks, until the door is shut."""
    with suppress(OSError):
        while True:
            door, _ = listener.accept()
            with door:
                started.append(PROCESSES.Process(target=run, args=(door,)))
                started[-1].start()


def run(door):
    """In a process of its own: run a command for a program, and tell it the code."""
    request, streams, _, _ = socket.recv_fds(door, MAX_REQUEST, 3)
    words, folder, environment, deaf = json.loads(request)
    for number, stream in enumerate(streams):
        os.dup2(stream, number)
        os.close(stream)
    if deaf:
        signal.signal(signal.SIGINT, signal.SIG_IGN)
    os.chdir(folder)
    os.environ.clear()
    os.environ.update(environment)
    sys.argv = ["knee-contact", *words]
    door.send(str(os.getpid()).encode())
    code = 1
    try:
        code = import_module(COMMAND).main(words)
    finally:
        sys.stdout.flush()
        sys.stderr.flush()
        door.send(str(code).encode())
