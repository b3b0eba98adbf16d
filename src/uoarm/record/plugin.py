"""The hook by which recordings are components; imports nothing that reads one."""

from __future__ import annotations

from attrs import frozen

from uoarm.bridge import Bridge, BridgeOptions, BridgeType, EndpointOptions, hookimpl, option
from uoarm.model import Options

__all__ = ["MOST_RATE", "RATE", "PlaybackOptions", "uoarm_bridge_types"]

MOST_RATE = 1_000_000_000
"""A second of a recording in a nanosecond: places are counted in these."""
RATE = {
    "anyOf": [{"type": "number", "exclusiveMinimum": 0, "maximum": MOST_RATE}, {"enum": ["fast"]}]
}
_BOOLEAN = {"type": "boolean"}


@frozen
class PlaybackOptions(BridgeOptions):
    """What a recording is played with."""

    file: str = option(
        "",
        {"type": "string", "minLength": 1, "x-uoarm-path": True, "examples": ["run.mcap"]},
        "MCAP file, .bag of ROS 1, or folder of rosbag2",
        required=True,
    )
    rate: float | str = option(
        1.0,
        RATE,
        "seconds of the recording in a second; `fast`: as fast as consumers take the messages",
    )
    from_: float = option(
        0.0,
        {"type": "number", "minimum": 0},
        "seconds after its first message at which it begins",
        unit="s",
    )
    loop: bool = option(
        False,
        _BOOLEAN,
        "whether it begins again at its end; otherwise its connections end in order",
    )
    paused: bool = option(
        False, _BOOLEAN, "whether it waits for the service @control before it begins"
    )
    follow: bool = option(
        False, _BOOLEAN, "gives what another process writes into the file from now on"
    )
    allow_motion: bool = option(
        False,
        _BOOLEAN,
        "whether it may feed an input that moves something; else such a plan is refused",
    )


def _create(name: str, options: PlaybackOptions) -> Bridge:
    from uoarm.record._bridge import RecordingBridge  # noqa: PLC0415 - only where there is one

    return RecordingBridge(name, options)


def _doctor() -> dict[str, str]:
    from uoarm.record._file import require_mcap  # noqa: PLC0415 - as above

    require_mcap()
    return {}


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
            bridge_options=PlaybackOptions,
            endpoint_options=EndpointOptions,  # it has none
            topic=_topic,
            doctor=_doctor,
            contract=2,
        )
    ]
