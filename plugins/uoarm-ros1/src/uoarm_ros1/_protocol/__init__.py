"""The protocol of ROS 1 as engines without I/O: octets in, octets out, and what they mean.

Everything that a peer may send has a bound before it is read: a hostile node or master costs no
more than its budget.
"""

from uoarm_ros1._protocol._handshake import (
    publisher_header,
    publisher_problem,
    service_header,
    service_problem,
    subscriber_header,
    subscriber_problem,
)
from uoarm_ros1._protocol._http import HttpReader, http_reply, http_request
from uoarm_ros1._protocol._slave import ParameterUpdate, PublisherUpdate, Shutdown, Slave
from uoarm_ros1._protocol._streams import (
    FrameReader,
    ProtocolError,
    ReplyReader,
    decode_header,
    encode_header,
    frames_of,
)
from uoarm_ros1._protocol._xmlrpc import Fault, decode_call, decode_reply, encode_call, encode_reply

__all__ = [
    "Fault",
    "FrameReader",
    "HttpReader",
    "ParameterUpdate",
    "ProtocolError",
    "PublisherUpdate",
    "ReplyReader",
    "Shutdown",
    "Slave",
    "decode_call",
    "decode_header",
    "decode_reply",
    "encode_call",
    "encode_header",
    "encode_reply",
    "frames_of",
    "http_reply",
    "http_request",
    "publisher_header",
    "publisher_problem",
    "service_header",
    "service_problem",
    "subscriber_header",
    "subscriber_problem",
]
