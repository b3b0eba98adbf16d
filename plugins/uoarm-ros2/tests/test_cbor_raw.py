"""rosbridge's `cbor-raw`: what the server serialises without ROS 2 is read by ROS 2 itself."""

from __future__ import annotations

import json
from typing import Any

from endpoints import Start
from rclpy.serialization import deserialize_message
from robots import rosbridge
from sensor_msgs.msg import Image
from websockets.sync.client import connect

from uoarm._wire import read_binary
from uoarm.model import Budget, BudgetUse
from uoarm.testing import patience

SIZE = 921_600
PICTURES = """
  pictures:
    components:
      - name: pictures
        bridge: ros
        output: {endpoint: [/raw/pictures, sensor_msgs/msg/Image]}
"""


def test_a_picture_of_ros_2_comes_out_as_ros_2_has_it(peer: Start) -> None:
    doer = peer("doer")
    doer.do("advertise", topic="/raw/pictures", kind="Image")
    with rosbridge(PICTURES) as (_, url), connect(url, max_size=None) as client:
        wish = {"op": "subscribe", "topic": "/uoarm/pictures", "compression": "cbor-raw"}
        client.send(json.dumps(wish))
        doer.do("subscriptions", topic="/raw/pictures", expected=1)
        doer.do("publish", topic="/raw/pictures", count=1, first=7, size=SIZE)
        frame = client.recv(timeout=patience())
    assert isinstance(frame, bytes)
    report: Any = read_binary(frame, BudgetUse(Budget(depth=8)))
    picture: Any = deserialize_message(report["msg"]["bytes"], Image)
    assert (picture.height, picture.step) == (7, SIZE)
    assert bytes(picture.data) == bytes(SIZE)
