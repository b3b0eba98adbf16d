"""Python environments for bridge hosts: made, listed, examined and removed by name."""

from uoarm.environments._environment import (
    Environment,
    EnvironmentFinding,
    environment_folder,
    environment_python,
    examine,
    find_interpreter,
    installed,
    listed,
    passed_on,
    remove,
)
from uoarm.environments._make import create, requirements

__all__ = [
    "Environment",
    "EnvironmentFinding",
    "create",
    "environment_folder",
    "environment_python",
    "examine",
    "find_interpreter",
    "installed",
    "listed",
    "passed_on",
    "remove",
    "requirements",
]
