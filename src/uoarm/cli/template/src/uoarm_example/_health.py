"""The health of each channel: what happened to it goes in, what changed is reported."""

from __future__ import annotations

import time
from collections.abc import Callable
from functools import partial

from uoarm.bridge import Channel, ChannelHealth, ChannelMonitor
from uoarm.model import Health
from uoarm_example._options import ExampleOptions

Report = Callable[[Channel, Health, str], None]


def monitored(channel: Channel, options: ExampleOptions, report: Report) -> ChannelMonitor:
    """Return what judges a channel, connected as it is when it opens."""
    clock = time.monotonic
    what = channel.endpoint.address[0]
    health = ChannelHealth(what, clock(), stale_after=options.stale_after, grace=options.grace)
    health.connected(clock())
    return ChannelMonitor(health, partial(report, channel), clock)
