"""The database: one row for each Observation, in SQLite or any database that SQLAlchemy reaches."""

from __future__ import annotations

import json
from typing import Any

from sqlalchemy import Column, MetaData, String, Table, Text, create_engine, insert, select, update
from sqlalchemy.exc import IntegrityError

__all__ = ["Store"]

_META = MetaData()
_OBSERVATIONS = Table(
    "observations",
    _META,
    Column("id", String(64), primary_key=True),
    Column("patient", String(128), index=True, nullable=False),
    Column("code", String(32), index=True, nullable=False),
    Column("effective", String(40), nullable=False),
    Column("resource", Text, nullable=False),
)
_MOST = 1000


class Store:
    """Observations by id. May be used from several threads.

    Args:
        url: of the database, `sqlite:///records.db` or `postgresql+psycopg://...`.
    """

    def __init__(self, url: str) -> None:
        self._engine = create_engine(url)
        _META.create_all(self._engine)

    def put(self, resource: dict[str, Any]) -> bool:
        """Store a resource under its id; return True when it is new, False when it was there."""
        row = {
            "id": resource["id"],
            "patient": resource["subject"]["reference"],
            "code": resource["code"]["coding"][0]["code"],
            "effective": resource["effectiveDateTime"],
            "resource": json.dumps(resource),
        }
        try:
            with self._engine.begin() as connection:
                connection.execute(insert(_OBSERVATIONS).values(row))
        except IntegrityError:
            with self._engine.begin() as connection:
                same = _OBSERVATIONS.c.id == row["id"]
                connection.execute(update(_OBSERVATIONS).where(same).values(row))
            return False
        return True

    def get(self, identity: str) -> dict[str, Any] | None:
        """Return one resource, None when there is none."""
        query = select(_OBSERVATIONS.c.resource).where(_OBSERVATIONS.c.id == identity)
        with self._engine.connect() as connection:
            found = connection.execute(query).scalar_one_or_none()
        return None if found is None else json.loads(found)

    def search(self, patient: str | None, code: str | None) -> list[dict[str, Any]]:
        """Return resources, the newest first, 1,000 at most."""
        query = select(_OBSERVATIONS.c.resource).order_by(_OBSERVATIONS.c.effective.desc())
        if patient is not None:
            reference = patient if patient.startswith("Patient/") else f"Patient/{patient}"
            query = query.where(_OBSERVATIONS.c.patient == reference)
        if code is not None:
            query = query.where(_OBSERVATIONS.c.code == code.rpartition("|")[2])
        with self._engine.connect() as connection:
            return [json.loads(text) for text in connection.execute(query.limit(_MOST)).scalars()]

    def close(self) -> None:
        """Let go of the database."""
        self._engine.dispose()
