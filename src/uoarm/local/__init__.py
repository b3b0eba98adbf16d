"""The built-in `python` bridge: plain Python callables, generators and classes as components."""

from uoarm._hints.arrays import HintError, Octets, Range, Shape, UInt8
from uoarm._hints.schemas import schema_of
from uoarm.local._bridge import PythonBridge, PythonOptions, uoarm_bridge_types
from uoarm.local._target import Emit, structure

__all__ = [
    "Emit",
    "HintError",
    "Octets",
    "PythonBridge",
    "PythonOptions",
    "Range",
    "Shape",
    "UInt8",
    "schema_of",
    "structure",
    "uoarm_bridge_types",
]
