"""Types for applications from a lock: a Python module, TypeScript declarations, one JSON Schema."""

from uoarm._types._python import write_python
from uoarm._types._shape import RobotTypes, read_functions, write_document
from uoarm._types._typescript import write_typescript

__all__ = ["RobotTypes", "read_functions", "write_document", "write_python", "write_typescript"]
