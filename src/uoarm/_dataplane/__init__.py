"""The data plane: how one message goes from where it arrives to where it is wanted."""

from uoarm._dataplane._failures import (
    Clock,
    FailureRule,
    FailureWatch,
    InputWatch,
    OutputWatch,
)
from uoarm._dataplane._outlet import Outlet
from uoarm._dataplane._queue import BoundedQueue, Inbox, QueueClosed
from uoarm._dataplane._route import MessageCheck, Route, make_check

__all__ = [
    "BoundedQueue",
    "Clock",
    "FailureRule",
    "FailureWatch",
    "Inbox",
    "InputWatch",
    "MessageCheck",
    "Outlet",
    "OutputWatch",
    "QueueClosed",
    "Route",
    "make_check",
]
