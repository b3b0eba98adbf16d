"""The web service: the part of FHIR R4's RESTful API that storing vital signs needs."""

from __future__ import annotations

import json
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from typing import Any

from starlette.applications import Starlette
from starlette.concurrency import run_in_threadpool
from starlette.requests import Request
from starlette.responses import JSONResponse, Response
from starlette.routing import Route

from healthbot_records.store import Store

__all__ = ["make_app"]

_TYPE = "application/fhir+json"
_LONGEST = 64 * 1024


class _Fhir(JSONResponse):
    media_type = _TYPE


class _BadResourceError(ValueError):
    """The body is no Observation that this service takes."""


def make_app(store: Store) -> Starlette:
    """Return the application; it closes the store when it ends."""

    @asynccontextmanager
    async def lifespan(_: Starlette) -> AsyncIterator[None]:
        yield
        store.close()

    async def put(request: Request) -> Response:
        try:
            resource = _read(await _body(request), request.path_params["identity"])
        except _BadResourceError as error:
            return _outcome(400, "invalid", str(error))
        is_new = await run_in_threadpool(store.put, resource)
        return _Fhir(resource, status_code=201 if is_new else 200)

    async def get(request: Request) -> Response:
        found = await run_in_threadpool(store.get, request.path_params["identity"])
        if found is None:
            return _outcome(404, "not-found", "there is no such Observation")
        return _Fhir(found)

    async def search(request: Request) -> Response:
        asked = request.query_params
        found = await run_in_threadpool(store.search, asked.get("patient"), asked.get("code"))
        entries = [{"resource": item} for item in found]
        bundle = {"resourceType": "Bundle", "type": "searchset", "total": len(found)}
        return _Fhir({**bundle, "entry": entries})

    async def metadata(_: Request) -> Response:
        return _Fhir(_CAPABILITIES)

    return Starlette(
        routes=[
            Route("/fhir/metadata", metadata),
            Route("/fhir/Observation", search),
            Route("/fhir/Observation/{identity}", get, methods=["GET"]),
            Route("/fhir/Observation/{identity}", put, methods=["PUT"]),
        ],
        lifespan=lifespan,
    )


async def _body(request: Request) -> bytes:
    body = b""
    async for part in request.stream():
        body += part
        if len(body) > _LONGEST:
            raise _BadResourceError(f"the resource is larger than {_LONGEST:,} bytes")
    return body


def _read(body: bytes, identity: str) -> dict[str, Any]:
    try:
        resource = json.loads(body)
        _Fhir(resource)  # what could never be handed out again is not taken
    except (ValueError, RecursionError) as error:
        raise _BadResourceError(f"not JSON: {error}") from error
    if not isinstance(resource, dict) or resource.get("resourceType") != "Observation":
        raise _BadResourceError("expected a resource of type Observation")
    if resource.get("id") != identity:
        raise _BadResourceError(f"the id {resource.get('id')!r} is not that of the address")
    try:
        texts = (
            resource["subject"]["reference"],
            resource["code"]["coding"][0]["code"],
            resource["effectiveDateTime"],
        )
    except (KeyError, IndexError, TypeError) as error:
        text = "subject.reference, code.coding[0].code and effectiveDateTime must be there"
        raise _BadResourceError(text) from error
    if not all(isinstance(text, str) for text in texts):
        raise _BadResourceError("reference, code and time must be text")
    return resource


def _outcome(status: int, code: str, text: str) -> Response:
    issue = {"severity": "error", "code": code, "diagnostics": text}
    return _Fhir({"resourceType": "OperationOutcome", "issue": [issue]}, status_code=status)


_CAPABILITIES: dict[str, Any] = {
    "resourceType": "CapabilityStatement",
    "status": "active",
    "date": "2026-11-21",
    "kind": "instance",
    "fhirVersion": "4.0.1",
    "format": [_TYPE],
    "rest": [
        {
            "mode": "server",
            "resource": [
                {
                    "type": "Observation",
                    "interaction": [{"code": code} for code in ("read", "update", "search-type")],
                    "updateCreate": True,
                }
            ],
        }
    ],
}
