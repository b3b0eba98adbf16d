"""All structures as one JSON Schema."""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import Any

from uoarm._types._functions import Functions

__all__ = ["write_document"]


def write_document(robot: Functions) -> str:
    """Return a JSON Schema with the structures below `$defs`, each a document of its own.

    `x-functions` says which function has which.
    """
    taken: set[str] = set()
    definitions: dict[str, Any] = {}
    for root in robot.roots:
        schema = root.schema
        if isinstance(schema, Mapping):
            own = schema.get("$id")
            # With one, `#/…` in it is of itself and not of the whole.
            if not isinstance(own, str) or own in taken:
                own = f"urn:uoarm:{root.name}"
            taken.add(own)
            schema = {**schema, "$id": own}
        definitions[root.name] = schema
    functions = {
        name: {
            **{f"output.{port}": _reference(kind) for port, kind in function.outputs.items()},
            **{f"input.{port}": _reference(kind) for port, kind in function.inputs.items()},
            **({"request": _reference(function.request)} if function.request else {}),
            **({"reply": _reference(function.reply)} if function.reply else {}),
        }
        for name, function in robot.functions.items()
    }
    whole = {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "$defs": definitions,
        "x-functions": functions,
    }
    return json.dumps(whole, indent=2, sort_keys=True) + "\n"


def _reference(name: str) -> dict[str, str]:
    return {"$ref": f"#/$defs/{name}"}
