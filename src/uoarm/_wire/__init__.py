"""The native protocol on the wire: its messages, their schema, and both forms of them.

Shared by the server and the client. Needs the packages of the extra `server`.
"""

from uoarm._wire._binary import LARGEST, read_binary, write_binary
from uoarm._wire._forms import (
    ASKED,
    BINARY_FORM,
    FORMS,
    TEXT_FORM,
    Form,
    check_asked,
    protocol_schema,
    reply_around,
    reply_to,
    salvage_id,
    write_or_error,
)
from uoarm._wire._text import dump_parts, is_octets, read_text, write_text
from uoarm._wire._text_schema import viewer_schema

__all__ = [
    "ASKED",
    "BINARY_FORM",
    "FORMS",
    "LARGEST",
    "TEXT_FORM",
    "Form",
    "check_asked",
    "dump_parts",
    "is_octets",
    "protocol_schema",
    "read_binary",
    "read_text",
    "reply_around",
    "reply_to",
    "salvage_id",
    "viewer_schema",
    "write_binary",
    "write_or_error",
    "write_text",
]
