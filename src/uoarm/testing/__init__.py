"""Help for testing bridges and components: instances of message structures.

Needs the packages of the extra `dev`; hypothesis is imported when it is used.
"""

from uoarm.testing._instances import find_instance, instances

__all__ = ["find_instance", "instances"]
