"""Messages between robot and clients: feeds, queues, senders, and the memory they hold."""

from uoarm.server.streams._client_streams import ClientStreams, feed_key
from uoarm.server.streams._feed import Envelope, Feed, FeedKey, Listener
from uoarm.server.streams._feed_registry import Announcement, FeedRegistry, Read, shown_event
from uoarm.server.streams._input_sender import Done, InputSender, check_message, read_message
from uoarm.server.streams._memory import Account, Charge, Held
from uoarm.server.streams._outbox import Lane, Outbox
from uoarm.server.streams._shared_views import Make
from uoarm.server.streams._shares import Shares, acting

__all__ = [
    "Account",
    "Announcement",
    "Charge",
    "ClientStreams",
    "Done",
    "Envelope",
    "Feed",
    "FeedKey",
    "FeedRegistry",
    "Held",
    "InputSender",
    "Lane",
    "Listener",
    "Make",
    "Outbox",
    "Read",
    "Shares",
    "acting",
    "check_message",
    "feed_key",
    "read_message",
    "shown_event",
]
