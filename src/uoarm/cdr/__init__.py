"""Messages as ROS and CORBA serialise them: to octets and back by their structure alone.

Nothing here needs a framework: a structure of a fixed layout says all, and so does the text of a
message file, as recordings hold it. One generator makes a reader or a writer of each layout, once.

Serialising needs numpy, which is loaded with `Codec`.
"""

from typing import TYPE_CHECKING

from uoarm._deferred import deferred

if TYPE_CHECKING:
    from uoarm.cdr._codec import (
        Codec,
        deserialiser,
        forget_octets,
        note_octets,
        octets_of,
        serialiser,
    )
    from uoarm.cdr._definition import RosDefinition, definition_of, structure_of_definition
    from uoarm.cdr._layout import (
        BASIC,
        CORBA,
        DDS,
        FLOAT32_MAX,
        NATIVE,
        ROS_1,
        SWITCH,
        ByteOrder,
        Encoding,
        basic_type,
        number_schema,
        ros_unit,
    )
    from uoarm.cdr._writing import Part

__all__ = [
    "BASIC",
    "CORBA",
    "DDS",
    "FLOAT32_MAX",
    "NATIVE",
    "ROS_1",
    "SWITCH",
    "ByteOrder",
    "Codec",
    "Encoding",
    "Part",
    "RosDefinition",
    "basic_type",
    "definition_of",
    "deserialiser",
    "forget_octets",
    "note_octets",
    "number_schema",
    "octets_of",
    "ros_unit",
    "serialiser",
    "structure_of_definition",
]

if not TYPE_CHECKING:
    __getattr__, __dir__ = deferred(
        __name__,
        {
            "_codec": (
                "Codec",
                "deserialiser",
                "forget_octets",
                "note_octets",
                "octets_of",
                "serialiser",
            ),
            "_definition": ("RosDefinition", "definition_of", "structure_of_definition"),
            "_layout": (
                "BASIC",
                "CORBA",
                "DDS",
                "FLOAT32_MAX",
                "NATIVE",
                "ROS_1",
                "SWITCH",
                "ByteOrder",
                "Encoding",
                "basic_type",
                "number_schema",
                "ros_unit",
            ),
            "_writing": ("Part",),
        },
    )
