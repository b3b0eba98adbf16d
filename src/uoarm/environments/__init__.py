"""Python environments for bridge hosts: made, listed, examined and removed by name."""

from uoarm.environments._doctor import EnvironmentFinding, examine
from uoarm.environments._make import create, requirements
from uoarm.environments._place import (
    Environment,
    environment_folder,
    environment_python,
    installed,
    listed,
    passed_on,
    remove,
)

__all__ = [
    "Environment",
    "EnvironmentFinding",
    "create",
    "environment_folder",
    "environment_python",
    "examine",
    "installed",
    "listed",
    "passed_on",
    "remove",
    "requirements",
]
