"""Messages as ROS serialises them: to octets and back by their structure, and their definitions.

Nothing here needs ROS: a structure of a fixed layout says all, and so does the text of a message
file, as recordings hold it.
"""

from uoarm.cdr._basic import BASIC, basic_type
from uoarm.cdr._definition import RosDefinition, definition_of, structure_of_definition
from uoarm.cdr._reading import deserialiser
from uoarm.cdr._writing import Part, serialiser

__all__ = [
    "BASIC",
    "Part",
    "RosDefinition",
    "basic_type",
    "definition_of",
    "deserialiser",
    "serialiser",
    "structure_of_definition",
]
