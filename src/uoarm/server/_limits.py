"""What the server allows one client, and all of them together, to use."""

from __future__ import annotations

from attrs import field, frozen
from attrs.validators import ge, gt

from uoarm.model import Budget


@frozen
class Limits:
    """Bounds of everything that a client can make grow.

    Attributes:
        message_bytes: longest message taken from a client.
        message_seconds: in which a message is finished that has begun to arrive.
        elements: values and names in a message taken from a client; octets and a typed array count
            as one.
        depth: deepest nesting of a message taken from a client.
        dimensions: of one array in it that says how many it has.
        connections: clients connected at one time.
        connections_per_address: of these, from one address.
        streams: functions, topics and services that one client holds open, of each kind.
        calls: requests of one client that are being worked on at one time, apart from functions
            that are being opened: those are streams.
        workers: threads for calls of all clients together; one that finds none free is refused.
        openings: threads in which functions are opened; one that finds none free waits for one.
        messages_per_second: a client that sends more is read more slowly.
        octets_per_second: likewise.
        elements_per_second: likewise; of all its messages together.
        queue_messages: data messages that wait for one client, at most.
        queue_seconds: after these a data message that waits for a client is dropped, where there
            are newer ones and the client did not ask for another queue.
        queue_bytes: bytes that wait for one client, at most.
        control_messages: replies and events that wait for one client; with more it is cut off.
        memory_bytes: octets of decoded values that are held for one client in all.
        total_memory_bytes: of these, for all clients together; a client that has less than its
            equal share is not refused because of others.
        feed_messages: messages of one function that wait for the server's loop.
        feed_bytes: octets of decoded values that these hold, where more than 16 wait; looked at
            with every 16th.
        handshake_seconds: for the whole opening handshake.
        ping_seconds: between two pings of a silent client.
        stall_seconds: without a sign of life, or without reading, before a client is cut off.
        resume_seconds: how long a session that its client asked to keep outlives a drop of its
            connection; 0: no session is kept.
        kept_sessions: sessions that wait for their client at one time.
        kept_bytes: memory that all of these hold; with more those that hold most are ended.
        request_seconds: for resolving and opening what a client asked for.
        call_seconds: for a service call that names no limit of its own; also the longest.
        stop_seconds: for closing when the server is stopped.
        recordings: that clients began and that run at one time.
        recording_bytes: of the files of one of these, after which it ends.
        recordings_bytes: of all files in their folder; with more none is begun.
    """

    message_bytes: int = field(default=16_777_216, validator=ge(1024))
    message_seconds: float = field(default=30.0, validator=gt(0))
    elements: int = field(default=500_000, validator=ge(1024))
    depth: int = field(default=64, validator=ge(4))
    dimensions: int = field(default=8, validator=ge(1))
    connections: int = field(default=4096, validator=ge(1))
    connections_per_address: int = field(default=4096, validator=ge(1))
    streams: int = field(default=1024, validator=ge(1))
    calls: int = field(default=32, validator=ge(1))
    workers: int = field(default=64, validator=ge(1))
    openings: int = field(default=64, validator=ge(1))
    messages_per_second: float = field(default=20_000.0, validator=gt(0))
    octets_per_second: float = field(default=134_217_728.0, validator=gt(0))
    elements_per_second: float = field(default=1_000_000.0, validator=gt(0))
    queue_messages: int = field(default=1024, validator=ge(1))
    queue_seconds: float = field(default=1.0, validator=gt(0))
    queue_bytes: int = field(default=16_777_216, validator=ge(1024))
    control_messages: int = field(default=4096, validator=ge(16))
    memory_bytes: int = field(default=134_217_728, validator=ge(1024))
    total_memory_bytes: int = field(default=1_073_741_824, validator=ge(1024))
    feed_messages: int = field(default=1024, validator=ge(1))
    feed_bytes: int = field(default=134_217_728, validator=ge(1024))
    handshake_seconds: float = field(default=5.0, validator=gt(0))
    ping_seconds: float = field(default=5.0, validator=gt(0))
    stall_seconds: float = field(default=10.0, validator=gt(0))
    resume_seconds: float = field(default=30.0, validator=ge(0))
    kept_sessions: int = field(default=256, validator=ge(0))
    kept_bytes: int = field(default=268_435_456, validator=ge(1024))
    request_seconds: float = field(default=30.0, validator=gt(0))
    call_seconds: float = field(default=60.0, validator=gt(0))
    stop_seconds: float = field(default=1.5, validator=gt(0))
    recordings: int = field(default=4, validator=ge(0))
    recording_bytes: int = field(default=2_147_483_648, validator=ge(1))
    recordings_bytes: int = field(default=10_737_418_240, validator=ge(1))

    @property
    def budget(self) -> Budget:
        """What one message of a client may cost."""
        return Budget(self.message_bytes, self.elements, self.depth, self.dimensions)
