"""The native protocol on the wire: its messages, their schema, and both forms of them.

Shared by the server and the client. Needs the packages of the extra `server`.
"""

from uoarm._wire._asked import ASKED, check_asked, protocol_schema, salvage_id
from uoarm._wire._binary import read_binary, write_binary
from uoarm._wire._forms import BINARY_FORM, FORMS, TEXT_FORM, Form, write_or_error
from uoarm._wire._skeleton import dump_parts, is_octets
from uoarm._wire._text import read_text

__all__ = [
    "ASKED",
    "BINARY_FORM",
    "FORMS",
    "TEXT_FORM",
    "Form",
    "check_asked",
    "dump_parts",
    "is_octets",
    "protocol_schema",
    "read_binary",
    "read_text",
    "salvage_id",
    "write_binary",
    "write_or_error",
]
