"""What a plugin for a protocol on top of MQTT builds upon: a connection, subscriptions, channels.

`settings_of` reads the options of a bridge that has `uoarm_mqtt.CONNECTION_OPTIONS` among its own.
A `BrokerConnection` of these settings connects at the first use and again after each break.
Receivers are called in the thread of the network and must return at once: a `Backlog` hands what
came to a thread of its own. `TopicSource` and `TopicSink` are the channels of one topic, with a
`Codec` that reads payloads within a budget; a subclass of it may read more than JSON. ::

    broker = BrokerConnection("plant", settings_of("plant", {"url": "mqtt://127.0.0.1"}), told)
    broker.subscribe(Receiver("plant/+/state", backlog.put, retained=True))
    broker.publish("plant/lamp", b"on", lambda outcome: None, qos=1)
    broker.close()

`uoarm-vda5050` is built upon it.
"""

from __future__ import annotations

from uoarm_mqtt._channels import Backlog, Report, TopicSink, TopicSource
from uoarm_mqtt._codec import Codec, limits_of
from uoarm_mqtt._link import BrokerConnection, Done, Outcome
from uoarm_mqtt._options import (
    Announcement,
    Port,
    Settings,
    settings_of,
)
from uoarm_mqtt._subscriptions import Incoming, Receiver

__all__ = [
    "Announcement",
    "Backlog",
    "BrokerConnection",
    "Codec",
    "Done",
    "Incoming",
    "Outcome",
    "Port",
    "Receiver",
    "Report",
    "Settings",
    "TopicSink",
    "TopicSource",
    "limits_of",
    "settings_of",
]
