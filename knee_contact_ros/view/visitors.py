"""Who may ask a server on this machine: programs and its own pages, and no page of another site.

A page whose name its owner lets point to 127.0.0.1 is no stranger to a browser ("DNS rebinding"): it may read what is
served there, and only the name in the request (Host) tells it.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from secrets import randbelow

HOSTS = r"(127\.0\.0\.1|localhost|\[::1\])"
"""Names of this machine"""


def is_allowed(headers: Sequence[tuple[str, str]], port: int, pages: Sequence[int] = ()) -> bool:
    """Whether a request with some headers to a port of this machine may be answered.

    It must ask for this machine by its name, once; a page that asks must come from this machine too, and from one of
    the ports `pages` if there are any.
    """
    hosts = [value for name, value in headers if name.lower() == "host"]
    origins = [value for name, value in headers if name.lower() == "origin"]
    if len(hosts) != 1 or not re.fullmatch(f"{HOSTS}:{port}", hosts[0], re.IGNORECASE):
        return False
    allowed = rf"http://{HOSTS}:({'|'.join(map(str, pages)) or '[0-9]+'})"
    return all(re.fullmatch(allowed, origin, re.IGNORECASE) for origin in origins)


def unguessable_address() -> str:
    """An address out of the millions that this machine has for itself: for servers that answer whoever finds them."""
    return ".".join(["127", *(str(1 + randbelow(254)) for _ in range(3))])
