"""A node of rospy that does what lines of JSON say; run by the Python that has rospy.

    python3 peer_node.py NAME

Each line is {"do": command, ...}; each is answered by one line.
"""

# Of Debian's own Python, which knows nothing of this repository.
# mypy: ignore-errors

import base64
import importlib
import json
import os
import random
import socket
import sys
import threading
import time

import genpy
import genpy.dynamic
import roslib.message
import rospy
from genpy_messages import DEFINED, fill, plain
from rospy.impl.tcpros import get_tcpros_handler

PUBLISHERS, CAME, KEPT = {}, {}, []


def filled(message, values):
    for name, kind in zip(message.__slots__, message._slot_types):
        if name in values:
            setattr(message, name, converted(kind, values[name]))
    return message


def define(type, definition):
    DEFINED.update(genpy.dynamic.generate_dynamic(type, definition))


def converted(kind, value):
    if kind.endswith("]"):
        element = kind[:-1].rpartition("[")[0]
        items = [converted(element, item) for item in value]
        return bytes(items) if element in ("uint8", "char") else items
    if kind == "time":
        return genpy.Time(value["secs"], value["nsecs"])
    if kind == "duration":
        return genpy.Duration(value["secs"], value["nsecs"])
    if isinstance(value, dict):
        return filled(message_class(kind)(), value)
    return value


def message_class(name):
    return DEFINED.get(name) or roslib.message.get_message_class(name)


def service_class(name):
    package, own = name.split("/")
    return getattr(importlib.import_module(package + ".srv"), own)


def advertise(topic, type, latch=False, queue=1000):
    PUBLISHERS[topic] = rospy.Publisher(topic, message_class(type), latch=latch, queue_size=queue)


def advertise_no_more(topic):
    PUBLISHERS.pop(topic).unregister()


def publish(topic, type, values, count=1, gap=0):
    kind = message_class(type)
    for _ in range(count):
        PUBLISHERS[topic].publish(filled(kind(), values))
        if gap:
            time.sleep(gap)


def publish_random(topic, type, count, seed=1):
    random_, sent = random.Random(seed), []
    for _ in range(count):
        message = fill(message_class(type)(), random_)
        sent.append(plain(message))
        PUBLISHERS[topic].publish(message)
    return sent


def advertise_octets(topic, type):
    known = message_class(type)

    class Raw(rospy.AnyMsg):
        _type, _md5sum, _full_text = known._type, known._md5sum, known._full_text

    PUBLISHERS[topic] = rospy.Publisher(topic, Raw, queue_size=1000)


def publish_octets(topic, octets):
    message = PUBLISHERS[topic].data_class()
    message._buff = base64.b64decode(octets)
    PUBLISHERS[topic].publish(message)


def stream(topic, type, values, rate):
    def run():
        while not rospy.is_shutdown() and topic in PUBLISHERS:
            try:
                publish(topic, type, values)
            except Exception:
                return
            time.sleep(1 / rate)

    threading.Thread(target=run, daemon=True).start()


def connections(topic):
    return PUBLISHERS[topic].get_num_connections()


def subscribe(topic, type):
    CAME[topic] = []
    KEPT.append(
        rospy.Subscriber(topic, message_class(type), lambda m: CAME[topic].append(plain(m)))
    )


def subscribe_no_more(topic):
    for kept in KEPT:
        if isinstance(kept, rospy.Subscriber) and kept.name == topic:
            kept.unregister()


def connect_again(topic):
    """Replace the connection to a publisher, as where two updates of the master name it at once."""
    connection = rospy.topics.get_topic_manager().get_subscriber_impl(topic).connections[0]
    place = ["TCPROS", *connection.dest_address]
    get_tcpros_handler().create_transport(topic, connection.endpoint_id, place)


def subscribe_any(topic):
    """Take whatever is published, as tools do: of any type and sum, with what its header says."""
    CAME[topic] = []

    def take(message):
        header = message._connection_header
        made = genpy.dynamic.generate_dynamic(header["type"], header["message_definition"])
        value = made[header["type"]]().deserialize(message._buff)
        CAME[topic].append([header["type"], header["md5sum"], plain(value)])

    KEPT.append(rospy.Subscriber(topic, rospy.AnyMsg, take))


def nodelays(topic):
    """Return of each connection of a publisher whether small messages are sent at once."""
    connections = PUBLISHERS[topic].impl.connections
    return [
        bool(connection.socket.getsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY))
        for connection in connections
    ]


def writers(topic):
    """Return how many connections the subscription to a topic has: what a base can look at."""
    return sum(
        kept.get_num_connections()
        for kept in KEPT
        if isinstance(kept, rospy.Subscriber) and kept.resolved_name == topic
    )


def echo(topic, to, type):
    out = rospy.Publisher(to, message_class(type), queue_size=1000)
    KEPT.append((out, rospy.Subscriber(topic, message_class(type), out.publish)))


def came(topic):
    return CAME[topic]


def count(topic):
    return len(CAME[topic])


def take(topic):
    taken, CAME[topic] = CAME[topic], []
    return taken


def serve(service, type, how="ok"):
    kind = service_class(type)

    def answer(request):
        if how == "fail":
            raise rospy.ServiceException("the service is broken")
        if how == "silent":
            threading.Event().wait(3600)
        reply = kind._response_class()
        if hasattr(reply, "success"):
            reply.success = bool(getattr(request, "data", True))
            reply.message = "data is %s" % getattr(request, "data", None)
        return reply

    KEPT.append(rospy.Service(service, kind, answer))


def serve_no_more(service):
    for served in [kept for kept in KEPT if getattr(kept, "resolved_name", "") == service]:
        served.shutdown()


def call(service, type, values):
    proxy = rospy.ServiceProxy(service, service_class(type))
    try:
        return plain(proxy(filled(service_class(type)._request_class(), values)))
    except rospy.ServiceException as error:
        return {"error": str(error)}


def call_persistently(service, type, requests):
    """Wait for a service, which asks it for its type alone, and call it over one connection."""
    rospy.wait_for_service(service, timeout=30)
    proxy = rospy.ServiceProxy(service, service_class(type), persistent=True)
    kind = service_class(type)._request_class
    replies = [plain(proxy(filled(kind(), values))) for values in requests]
    proxy.close()
    return replies


def act_by_hand(action, type, how):
    """Serve an action whose goals are refused, or end as recalled."""
    import actionlib

    package, own = type.split("/")
    kind = getattr(importlib.import_module(package + ".msg"), own)

    def take(goal):
        if how == "reject":
            goal.set_rejected(text="not today")
        elif how == "recall":
            goal.set_cancel_requested()
            goal.set_canceled(text="called back")

    server = actionlib.ActionServer(action, kind, take, lambda goal: None, auto_start=False)
    server.start()
    KEPT.append(server)


def look_up(frames, seconds):
    """Return which frames tf2 finds from `world` on, in time."""
    import tf2_ros

    buffer = tf2_ros.Buffer()
    KEPT.append(tf2_ros.TransformListener(buffer))
    until = time.monotonic() + seconds
    found = []
    while time.monotonic() < until and len(found) < len(frames):
        found = [name for name in frames if buffer.can_transform("world", name, rospy.Time(0))]
        time.sleep(0.02)
    return found


def act(action, type, how="ok"):
    import actionlib

    package, own = type.split("/")
    module = importlib.import_module(package + ".msg")
    stem = own[: -len("Action")]

    def execute(goal):
        feedback, result = getattr(module, stem + "Feedback")(), getattr(module, stem + "Result")()
        server.publish_feedback(feedback)
        if how == "abort":
            server.set_aborted(result, "it cannot")
        elif how == "wait":
            while not server.is_preempt_requested() and not rospy.is_shutdown():
                time.sleep(0.01)
            server.set_preempted(result, "it was asked to stop")
        else:
            if hasattr(result, "sum"):
                result.sum = goal.a + goal.b
            server.set_succeeded(result)

    server = actionlib.SimpleActionServer(action, getattr(module, own), execute, auto_start=False)
    server.start()
    KEPT.append(server)


def send_goal(action, type, values, timeout=30, cancel=False):
    import actionlib

    package, own = type.split("/")
    module = importlib.import_module(package + ".msg")
    client = actionlib.SimpleActionClient(action, getattr(module, own))
    if not client.wait_for_server(rospy.Duration(timeout)):
        return {"error": "no server"}
    client.send_goal(filled(getattr(module, own[: -len("Action")] + "Goal")(), values))
    if cancel:
        while client.get_state() == 0:
            time.sleep(0.01)
        client.cancel_goal()
    client.wait_for_result(rospy.Duration(timeout))
    result = client.get_result()
    return {
        "state": client.get_state(),
        "text": client.get_goal_status_text(),
        "result": None if result is None else plain(result),
    }


def static_transforms(frames):
    import geometry_msgs.msg
    import tf2_ros

    broadcaster = tf2_ros.StaticTransformBroadcaster()
    made = []
    for frame in frames:
        transform = geometry_msgs.msg.TransformStamped()
        transform.header.frame_id, transform.child_frame_id = "world", frame
        transform.transform.rotation.w = 1.0
        made.append(transform)
    broadcaster.sendTransform(made)
    KEPT.append(broadcaster)


def set_param(name, value):
    rospy.set_param(name, value)


def get_param(name):
    return rospy.get_param(name, None)


def delete_param(name):
    rospy.delete_param(name)


def threads():
    return threading.active_count()


COMMANDS = {name: value for name, value in globals().items() if callable(value)}


def main():
    rospy.init_node(sys.argv[1], disable_signals=True)
    replies = os.fdopen(os.dup(1), "w")
    os.dup2(2, 1)  # what rospy prints is no reply
    print(json.dumps({"is": "ready"}), file=replies, flush=True)
    for line in sys.stdin:
        given = json.loads(line)
        try:
            result = {"is": COMMANDS[given.pop("do")](**given)}
        except Exception as error:
            result = {"raised": "%s: %s" % (type(error).__name__, error)}
        print(json.dumps(result), file=replies, flush=True)
    os._exit(0)


main()
