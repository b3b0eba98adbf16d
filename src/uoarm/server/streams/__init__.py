"""Messages between robot and clients: feeds, queues, senders, and the memory they hold."""

from uoarm.server.streams._action_goals import (
    ActionRunners,
    Goal,
    GoalStatus,
    StreamRunner,
    is_action,
)
from uoarm.server.streams._client_streams import ClientStreams, feed_key
from uoarm.server.streams._feed import Envelope, Feed, FeedKey, Listener
from uoarm.server.streams._feed_registry import (
    ChangeNotice,
    FeedRegistry,
    Watcher,
    shown_event,
)
from uoarm.server.streams._input_sender import (
    CommandAges,
    Done,
    InputSender,
    Read,
    check_message,
    read_message,
)
from uoarm.server.streams._memory import Account, Charge, MemoryUse, Shares, acting
from uoarm.server.streams._outbox import Lane, Outbox
from uoarm.server.streams._subscription import MessageForm, Subscription, Throttle
from uoarm.server.streams._workers import Make

__all__ = [
    "Account",
    "ActionRunners",
    "ChangeNotice",
    "Charge",
    "ClientStreams",
    "CommandAges",
    "Done",
    "Envelope",
    "Feed",
    "FeedKey",
    "FeedRegistry",
    "Goal",
    "GoalStatus",
    "InputSender",
    "Lane",
    "Listener",
    "Make",
    "MemoryUse",
    "MessageForm",
    "Outbox",
    "Read",
    "Shares",
    "StreamRunner",
    "Subscription",
    "Throttle",
    "Watcher",
    "acting",
    "check_message",
    "feed_key",
    "is_action",
    "read_message",
    "shown_event",
]
