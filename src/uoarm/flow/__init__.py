"""The data plane: how one message goes from where it arrives to where it is wanted."""

from uoarm.flow._inbox import Inbox
from uoarm.flow._outlet import Outlet
from uoarm.flow._queue import BoundedQueue, QueueClosed
from uoarm.flow._route import Clock, Route
from uoarm.flow._validation import make_check

__all__ = ["BoundedQueue", "Clock", "Inbox", "Outlet", "QueueClosed", "Route", "make_check"]
