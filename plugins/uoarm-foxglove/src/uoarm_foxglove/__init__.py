"""The Foxglove WebSocket protocol before `uoarm serve`: viewers connect live and unmodified.

Source of the protocol: https://github.com/foxglove/ws-protocol, docs/spec.md.
"""

__all__: list[str] = []
