"""Arguments of calls and goals: by name, or, as rosbridge allows, as a list in order."""

from __future__ import annotations

from collections.abc import Mapping

from uoarm.errors import UsageError
from uoarm.model import Message, MessageStructure
from uoarm.server.front_end import TEXT_FORM, read_message

__all__ = ["name_arguments", "read_arguments"]


def read_arguments(structure: MessageStructure, arguments: Message) -> Message:
    """Return the logical value of arguments; raises as `read_message` and `name_arguments`."""
    return read_message(TEXT_FORM, structure, name_arguments(structure, arguments))


def name_arguments(structure: MessageStructure, arguments: Message) -> Message:
    """Return arguments by name; a list stands for the fields in their order.

    Raises:
        UsageError: the list has more arguments than there are fields.
    """
    schema = structure.schema
    if arguments is None:
        return {}
    if isinstance(arguments, list) and isinstance(schema, Mapping):
        names = schema.get("properties")
        if isinstance(names, Mapping):
            if len(arguments) > len(names):
                raise UsageError(f"expected at most {len(names)} arguments, got {len(arguments)}")
            return dict(zip(names, arguments, strict=False))
    return arguments
