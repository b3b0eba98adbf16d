"""A certificate authority for tests: real certificates of servers and clients."""

from __future__ import annotations

from datetime import datetime, timedelta, timezone
from pathlib import Path

import trustme

_DAY = timedelta(days=1)


class Authority:
    """Signs certificates; each is a PEM file with its key, beside the authority's own."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._ca = trustme.CA()
        self.path = folder / "authority.pem"
        self._ca.cert_pem.write_to_path(self.path)

    def issue(self, name: str, *, ends: timedelta = _DAY) -> Path:
        now = datetime.now(timezone.utc)
        path = self._folder / f"{name}.pem"
        issued = self._ca.issue_cert(
            "localhost",
            "127.0.0.1",
            common_name=name,
            not_before=now - 2 * _DAY,
            not_after=now + ends,
        )
        issued.private_key_and_cert_chain_pem.write_to_path(path)
        return path
