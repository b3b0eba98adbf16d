"""A durable queue in one SQLite file: what was put survives a crash until it is taken off."""

from __future__ import annotations

import json
import sqlite3
import threading
from pathlib import Path
from typing import Any

__all__ = ["Spool"]


class Spool:
    """Resources that wait to be sent, oldest first. May be used from several threads."""

    def __init__(self, file: Path) -> None:
        self._lock = threading.Lock()
        self._database = sqlite3.connect(file, check_same_thread=False, isolation_level=None)
        self._database.execute("PRAGMA journal_mode = WAL")
        self._database.execute("PRAGMA synchronous = FULL")
        self._database.execute(
            "CREATE TABLE IF NOT EXISTS waiting ("
            "place INTEGER PRIMARY KEY, id TEXT UNIQUE, resource TEXT NOT NULL)"
        )
        self._database.execute(
            "CREATE TABLE IF NOT EXISTS refused (id TEXT PRIMARY KEY, resource TEXT, why TEXT)"
        )

    def put(self, resource: dict[str, Any]) -> None:
        """Add a resource, once: one that waits already is replaced in its place.

        Where the service refused it before, it is to be asked again.

        Raises:
            ValueError: a number in it is none that JSON has; nothing is added.
        """
        row = (resource["id"], json.dumps(resource, allow_nan=False))
        with self._lock:
            self._database.execute("DELETE FROM refused WHERE id = ?", (resource["id"],))
            self._database.execute(
                "INSERT INTO waiting (id, resource) VALUES (?, ?) "
                "ON CONFLICT (id) DO UPDATE SET resource = excluded.resource",
                row,
            )

    def oldest(self) -> dict[str, Any] | None:
        """Return the resource that waits longest, None when nothing waits; it stays."""
        with self._lock:
            row = self._database.execute(
                "SELECT resource FROM waiting ORDER BY place LIMIT 1"
            ).fetchone()
        return None if row is None else json.loads(row[0])

    def remove(self, identity: str) -> None:
        """Take off what has been stored."""
        with self._lock:
            self._database.execute("DELETE FROM waiting WHERE id = ?", (identity,))

    def refuse(self, identity: str, why: str) -> None:
        """Put aside what the service will never take, so that it holds up nothing."""
        with self._lock:
            self._database.execute(
                "INSERT OR REPLACE INTO refused SELECT id, resource, ? FROM waiting WHERE id = ?",
                (why, identity),
            )
            self._database.execute("DELETE FROM waiting WHERE id = ?", (identity,))

    def refusal(self, identity: str) -> str | None:
        """Return why the service refused a resource, None where it did not."""
        with self._lock:
            row = self._database.execute(
                "SELECT why FROM refused WHERE id = ?", (identity,)
            ).fetchone()
        return None if row is None else str(row[0])

    def holds(self, identity: str) -> bool:
        """Whether a resource still waits."""
        query = "SELECT 1 FROM waiting WHERE id = ?"
        with self._lock:
            return self._database.execute(query, (identity,)).fetchone() is not None

    def __len__(self) -> int:
        with self._lock:
            return int(self._database.execute("SELECT count(*) FROM waiting").fetchone()[0])

    def close(self) -> None:
        """Close the file."""
        with self._lock:
            self._database.close()
