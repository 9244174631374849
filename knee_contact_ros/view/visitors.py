"""Requests that a server on this machine may answer: those of programs and its own pages, not of other sites' pages.

A page under a name that its owner lets point to 127.0.0.1 ("DNS rebinding") may read what is served there, as far as
a browser is concerned; only the name in the request (Host) shows where it comes from.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from secrets import randbelow

HOSTS = r"(127\.0\.0\.1|localhost|\[::1\])"
"""Names of this machine, as a regular expression"""


def is_allowed(headers: Sequence[tuple[str, str]], port: int, pages: Sequence[int] = ()) -> bool:
    """Return whether a request with these headers to a port of this machine may be answered.

    The request must have exactly one Host, a name of this machine. If a page sent it (Origin), the page must come from
    this machine too, and from one of the ports `pages` if any are given.
    """
    hosts = [value for name, value in headers if name.lower() == "host"]
    origins = [value for name, value in headers if name.lower() == "origin"]
    if len(hosts) != 1 or not re.fullmatch(f"{HOSTS}:{port}", hosts[0], re.IGNORECASE):
        return False
    allowed = rf"http://{HOSTS}:({'|'.join(map(str, pages)) or '[0-9]+'})"
    return all(re.fullmatch(allowed, origin, re.IGNORECASE) for origin in origins)


def unguessable_address() -> str:
    """Return a random loopback address, one of millions: for servers that answer everybody who finds them."""
    return ".".join(["127", *(str(1 + randbelow(254)) for _ in range(3))])
