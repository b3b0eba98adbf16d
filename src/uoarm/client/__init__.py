"""An asyncio client of `uoarm serve`: the functions of a robot elsewhere, as if they were here.

Needs the packages of the extra `server`.
"""

from uoarm.client._client import Client, ServerError, connect
from uoarm.client._stream import RemoteStream
from uoarm.client._trust import trust_fingerprint

__all__ = ["Client", "RemoteStream", "ServerError", "connect", "trust_fingerprint"]
