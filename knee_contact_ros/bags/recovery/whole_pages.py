"""A sqlite file of which only whole pages count: sqlite itself takes what is missing of the last one for zeros."""

from __future__ import annotations

import apsw

NAME = "knee_contact_whole_pages"


class _File(apsw.VFSFile):
    def xRead(self, amount: int, offset: int) -> bytes:  # noqa: N802  (sqlite's name)
        data = super().xRead(amount, offset)
        return data if len(data) == amount else b""


class _WholePages(apsw.VFS):
    def __init__(self) -> None:
        super().__init__(NAME, "")

    def xOpen(self, name: str | apsw.URIFilename | None, flags: list[int]) -> apsw.VFSFile:  # noqa: N802
        return _File("", name, flags)


_registered = _WholePages()  # for as long as it lives
