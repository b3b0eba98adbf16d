"""What a plugin for a protocol on top of MQTT builds upon: a connection, subscriptions, channels.

`connection_options` reads the options of a bridge whose class is below `BrokerOptions`. A
`BrokerConnection` of these connects at the first use and again after each break.
Receivers are called in the thread of the network and must return at once: a `ReceiveQueue` of
`uoarm.bridge` hands what came to a thread of its own. `MqttSource` and `MqttSink` are the channels
of one topic, with a `PayloadCodec` that reads payloads within a budget; a subclass of it may read
more than JSON. ::

    options = connection_options("plant", BrokerOptions.of({"url": "mqtt://127.0.0.1"}))
    broker = BrokerConnection("plant", options, report)
    broker.subscribe(Receiver("plant/+/state", queue.put, retained=True))
    broker.publish("plant/lamp", b"on")
    broker.close()

`uoarm-vda5050` is built upon it.
"""

from __future__ import annotations

from uoarm_mqtt._channels import MqttSink, MqttSource, Report
from uoarm_mqtt._codec import PayloadCodec, limits_of
from uoarm_mqtt._link import BrokerConnection, Done, PacketOutcome
from uoarm_mqtt._options import (
    BrokerOptions,
    ConnectionOptions,
    PresenceAnnouncement,
    TopicOptions,
    connection_options,
)
from uoarm_mqtt._subscriptions import ReceivedMessage, Receiver

__all__ = [
    "BrokerConnection",
    "BrokerOptions",
    "ConnectionOptions",
    "Done",
    "MqttSink",
    "MqttSource",
    "PacketOutcome",
    "PayloadCodec",
    "PresenceAnnouncement",
    "ReceivedMessage",
    "Receiver",
    "Report",
    "TopicOptions",
    "connection_options",
    "limits_of",
]
