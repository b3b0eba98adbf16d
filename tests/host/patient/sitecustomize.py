"""Python reads this as it starts in a host of the tests: it waits for its manager as they do.

A host gives up a message when its manager has handled none for a second, or when its link has been
full for a fifth of one. Here the manager is only starved.
"""

import os

from uoarm._host.agent import flows
from uoarm._host.transport import socket_transport, zenoh_transport

patience = float(os.environ["UOARM_TEST_PATIENCE"])
flows._PATIENCE_SECONDS = patience
socket_transport._FULL_SECONDS = zenoh_transport._FULL_SECONDS = patience
