"""A gate before a server that answers everybody, as Rerun's does: it lets in only whom `is_allowed` allows."""

from __future__ import annotations

import asyncio
from contextlib import suppress
from email import message_from_bytes
from threading import Thread

from knee_contact_ros.system.ports import LOCALHOST
from knee_contact_ros.view.visitors import is_allowed

HTTP_2 = b"PRI * HTTP/2.0\r\n\r\n"
"""First bytes of a program's connection; a browser sends them only behind encryption"""
REFUSAL = b"HTTP/1.1 403 Forbidden\r\nContent-Length: 0\r\nConnection: close\r\n\r\n"
PATIENCE = 10.0
"""Time [s] within which the first request must come"""
BLOCK = 1 << 16
"""Bytes that are passed on at once"""


class Gate:
    """A port of the loopback interface whose connections are passed on if their first request is allowed.

    The first request is enough: a browser does not use a connection that it opened under one name for another.
    """

    def __init__(self, port: int, server: tuple[str, int]) -> None:
        """Listen on `port`, and pass connections on to the address and port of `server`.

        Raises:
            OSError: the port is taken.
        """
        self._port, self._server = port, server
        self._loop = asyncio.new_event_loop()
        self._listener = self._loop.run_until_complete(asyncio.start_server(self._visit, LOCALHOST, port))
        self._thread = Thread(target=self._loop.run_forever, name="gate", daemon=True)
        self._thread.start()

    def close(self) -> None:
        """Stop listening, and end all connections."""
        self._loop.call_soon_threadsafe(self._end)
        self._thread.join()
        self._loop.close()

    def _end(self) -> None:
        """End all connections, and then the loop."""
        self._listener.close()
        visits = asyncio.all_tasks(self._loop)
        for visit in visits:
            visit.cancel()
        asyncio.gather(*visits, return_exceptions=True).add_done_callback(lambda _: self._loop.stop())

    async def _visit(self, visitor: asyncio.StreamReader, answer: asyncio.StreamWriter) -> None:
        """Check the first request of a connection, and pass on all data in both directions, or refuse."""
        with suppress(OSError, EOFError, TimeoutError, asyncio.LimitOverrunError, asyncio.CancelledError):
            begin = await asyncio.wait_for(visitor.readuntil(b"\r\n\r\n"), PATIENCE)
            if not self._may_enter(begin):
                answer.write(REFUSAL)
                await answer.drain()
            else:
                source, sink = await asyncio.open_connection(*self._server)
                sink.write(begin)
                await asyncio.gather(_pass_on(visitor, sink), _pass_on(source, answer))
        answer.close()

    def _may_enter(self, begin: bytes) -> bool:
        """Return whether a connection that begins so is allowed."""
        if begin == HTTP_2:
            return True
        headers = message_from_bytes(begin.partition(b"\r\n")[2])
        return is_allowed(list(headers.items()), self._port)


async def _pass_on(source: asyncio.StreamReader, sink: asyncio.StreamWriter) -> None:
    """Pass on all data, until one of both sides closes."""
    try:
        while data := await source.read(BLOCK):
            sink.write(data)
            await sink.drain()
    finally:
        sink.close()
