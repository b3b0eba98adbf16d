"""A naming service for programs and tests: omniNames, without any other installation.

Importing this module imports no middleware.

with NameServer() as names:
    print(names.address)
"""

from __future__ import annotations

from uoarm_rtm._nameserver import NameServer, nameserver_command

__all__ = ["NameServer", "nameserver_command"]
