"""The WebSocket front end: every function of every framework, for any language and any browser.

Needs the packages of the extra `server`.
"""

from uoarm.server._limits import Limits

__all__ = ["Limits"]
