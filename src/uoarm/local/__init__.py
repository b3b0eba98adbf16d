"""The built-in `python` bridge: plain Python callables, generators and classes as components."""

from uoarm.local._bridge import PythonBridge, uoarm_bridge_types
from uoarm.local._hints import HintError, Octets, Range, UInt8, schema_of
from uoarm.local._instance import Emit
from uoarm.local._target import structure

__all__ = [
    "Emit",
    "HintError",
    "Octets",
    "PythonBridge",
    "Range",
    "UInt8",
    "schema_of",
    "structure",
    "uoarm_bridge_types",
]
