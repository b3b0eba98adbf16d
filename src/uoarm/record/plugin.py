"""The hook by which recordings are components; imports nothing that reads one."""

from __future__ import annotations

from uoarm.bridge import Bridge, BridgeType, hookimpl
from uoarm.model import Options

__all__ = ["RECORDING_OPTIONS", "uoarm_bridge_types"]

RECORDING_OPTIONS = {
    "type": "object",
    "properties": {
        "file": {
            "type": "string",
            "minLength": 1,
            "x-uoarm-path": True,
            "examples": ["run.mcap"],
            "description": "An MCAP file, a .bag of ROS 1, or a folder of rosbag2.",
        },
        "rate": {
            "anyOf": [{"type": "number", "exclusiveMinimum": 0}, {"enum": ["fast"]}],
            "default": 1.0,
            "description": "Seconds of the recording in a second; fast: as messages are taken.",
        },
        "from": {
            "type": "number",
            "minimum": 0,
            "default": 0,
            "description": "Seconds after its first message at which it begins.",
        },
        "loop": {
            "type": "boolean",
            "default": False,
            "description": "Whether it begins again when it has been played.",
        },
        "paused": {
            "type": "boolean",
            "default": False,
            "description": "Whether it waits for the service @control before it begins.",
        },
        "follow": {
            "type": "boolean",
            "default": False,
            "description": "Give what another process writes into the file from now on.",
        },
        "allow_motion": {
            "type": "boolean",
            "default": False,
            "description": "Whether inputs that move something may be fed from it.",
        },
    },
    "required": ["file"],
    "additionalProperties": False,
}


def _create(name: str, options: Options) -> Bridge:
    from uoarm.record._bridge import RecordingBridge  # noqa: PLC0415 - only where there is one

    return RecordingBridge(name, options)


def _topic(address: tuple[str, ...], options: Options) -> str:
    del options
    return address[0] if len(address) == 1 else ""


@hookimpl
def uoarm_bridge_types() -> list[BridgeType]:
    """Return the one bridge type of recordings."""
    return [
        BridgeType(
            name="recording",
            summary="channels of MCAP files and of bags of ROS, played again",
            create=_create,
            bridge_options=RECORDING_OPTIONS,
            topic=_topic,
            contract=2,
        )
    ]
