"""Functions with the names that the protocol's conformance suite calls."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import TypedDict

from uoarm.local import structure

CONFIGURATION = """
version: 1
bridges: {python: {}}
functions:
  test_simple_text:
    components:
      - {name: simple, bridge: python, service: {endpoint: ["conformance_parts:simple"]}}
  test_error_handling:
    components:
      - {name: failing, bridge: python, service: {endpoint: ["conformance_parts:fail"]}}
  test_headers:
    components:
      - {name: headed, bridge: python, service: {endpoint: ["conformance_parts:headed"]}}
  state:
    components:
      - {name: state, bridge: python, output: {endpoint: ["conformance_parts:states"]}}
"""
REGION = {
    "type": "object",
    "properties": {"region": {"type": "string", "x-mcp-header": "Region"}},
    "required": ["region"],
    "additionalProperties": False,
}


class Nothing(TypedDict):
    pass


class Text(TypedDict):
    text: str


def simple(request: Nothing) -> Text:
    return {"text": "This is a simple text response for testing."}


def fail(request: Nothing) -> Text:
    raise ValueError("This tool intentionally returns an error for testing")


@structure(request=REGION, reply=REGION)
def headed(request: Mapping[str, str]) -> Mapping[str, str]:
    return request


def states() -> Iterator[Text]:
    yield {"text": "ready"}
