"""A ROS 2 action behind the rosbridge endpoint, with an unmodified client."""

from __future__ import annotations

from pathlib import Path

from endpoints import Start
from robots import rosbridge
from tests.processes import run_python  # type: ignore[import-not-found]

CLIENT = Path(__file__).with_name("action_client.py")
ADDRESS = "/fibonacci, test_msgs/action/Fibonacci"
ACTION = f"""
  fibonacci:
    components:
      - name: fibonacci
        bridge: ros
        inputs:
          goal: {{endpoint: [{ADDRESS}]}}
          cancel: {{endpoint: [{ADDRESS}]}}
        outputs:
          status: {{endpoint: [{ADDRESS}]}}
          feedback: {{endpoint: [{ADDRESS}]}}
          result: {{endpoint: [{ADDRESS}]}}
"""


def test_roslibpy_sends_goals_to_an_action(peer: Start) -> None:
    peer("doer", "threads").do("act", name="/fibonacci")
    with rosbridge(ACTION) as (_, url):
        done = run_python(CLIENT, url)
    assert done.stdout == "done\n", done.stdout + done.stderr


PARTLY = """
import sys
import roslibpy

from uoarm.testing import patience

ros = roslibpy.Ros(sys.argv[1])
ros.run(timeout=patience())
picture = roslibpy.Topic(ros, "/uoarm/picture", "sensor_msgs/Image")
picture.publish(roslibpy.Message({"height": 7, "header": {"frame_id": "eye"}}))
service = roslibpy.Service(ros, "/uoarm/increment", "test_msgs/BasicTypes")
reply = service.call(roslibpy.ServiceRequest({"int64_value": 5}), timeout=patience())
print(reply["int64_value"])
ros.close()
"""
FIELDS = """
  picture:
    components:
      - name: picture
        bridge: ros
        input: {endpoint: [/picture, sensor_msgs/msg/Image]}
  increment:
    components:
      - name: increment
        bridge: ros
        service: {endpoint: [/increment, test_msgs/srv/BasicTypes]}
"""


def test_fields_that_a_client_leaves_out_are_filled_as_by_rosbridge(
    peer: Start, tmp_path: Path
) -> None:
    server, listener = peer("server", "threads"), peer("listener")
    server.do("serve", name="/increment")
    listener.do("subscribe", topic="/picture", kind="Image")
    program = tmp_path / "partly.py"
    program.write_text(PARTLY)
    with rosbridge(FIELDS) as (_, url):
        done = run_python(program, url)
        assert done.stdout == "6\n", done.stdout + done.stderr
        assert listener.do("report", topic="/picture", expected=1) == [7]
