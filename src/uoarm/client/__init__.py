"""An asyncio client of `uoarm serve`: the functions of a robot elsewhere, as if they were here.

Needs the packages of the extra `server`.
"""

from uoarm._origin import requiring

with requiring("server", "uoarm.client"):
    from uoarm.client._client import RemoteRobot
    from uoarm.client._connect import ServerAddress, connect, trust_fingerprint
    from uoarm.client._requests import ServerError, ThreadAnswer
    from uoarm.client._stream import RemoteStream

__all__ = [
    "RemoteRobot",
    "RemoteStream",
    "ServerAddress",
    "ServerError",
    "ThreadAnswer",
    "connect",
    "trust_fingerprint",
]
