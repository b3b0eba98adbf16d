"""uoarm, the UoA Robot Manager: ask for a robot function, get it from any framework."""

from uoarm._version import __version__

__all__ = ["__version__"]
