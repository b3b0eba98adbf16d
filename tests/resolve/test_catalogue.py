"""What a bridge says of endpoints, as plans have it."""

from __future__ import annotations

from uoarm._resolve import StructureCache, Structures
from uoarm.bridge import Bridge, Description
from uoarm.config import loads
from uoarm.model import Endpoint, MessageStructure

ROBOT = loads("""
version: 1
bridges: {a: {plugin: memory}}
functions:
  camera:
    components:
      - name: camera
        bridge: a
        inputs: {light: {endpoint: [light], structure: {type: integer}}}
        output: {endpoint: [picture]}
""")


class Noting:
    """Knows two endpoints, of which a reader should know something."""

    def describe(self, endpoint: Endpoint, *, timeout: float) -> Description:
        del timeout
        return Description(
            MessageStructure({"type": "integer"}), note=f"{endpoint.address[0]} is slow"
        )


def test_what_a_reader_should_know_of_an_endpoint_is_in_the_plan() -> None:
    bridge: Bridge = Noting()  # type: ignore[assignment]  # as much of one as is asked
    found = StructureCache(lambda _: bridge).structures(ROBOT.functions["camera"].components[0])
    assert isinstance(found, Structures)
    assert found.warnings == (
        "camera.input.light: light is slow",
        "camera.input.light: the declared structure replaces the bridge's",
        "camera.output.default: picture is slow",
    )
