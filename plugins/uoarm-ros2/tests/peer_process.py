"""The other end of the tests: plain rclpy, driven by lines of JSON, knowing no uoarm."""

from __future__ import annotations

import importlib
import json
import os
import queue
import signal
import sys
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from typing import Any

import rclpy
import test_msgs.msg
from geometry_msgs.msg import PoseStamped
from lifecycle_node import Numbers
from rclpy.action import ActionClient, ActionServer, CancelResponse, GoalResponse
from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.duration import Duration
from rclpy.executors import ExternalShutdownException, MultiThreadedExecutor, SingleThreadedExecutor
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.qos import (
    DurabilityPolicy,
    HistoryPolicy,
    LivelinessPolicy,
    QoSProfile,
    ReliabilityPolicy,
)
from redefinition import redefine, redefine_goal_reply, redefine_reply
from sensor_msgs.msg import Image
from std_msgs.msg import Int64, String
from std_srvs.srv import SetBool
from test_msgs.action import Fibonacci
from test_msgs.srv import BasicTypes

PATIENCE = float(os.environ["PATIENCE"])


def profile(
    reliability: str = "reliable",
    durability: str = "volatile",
    depth: int = 100,
    deadline: float | None = None,
    history: str = "keep_last",
    lease: float | None = None,
) -> Any:
    made = QoSProfile(
        reliability=ReliabilityPolicy[reliability.upper()],
        durability=DurabilityPolicy[durability.upper()],
        history=HistoryPolicy[history.upper()],
        depth=depth,
    )
    if lease is not None:
        made.liveliness = LivelinessPolicy.MANUAL_BY_TOPIC
        made.liveliness_lease_duration = Duration(nanoseconds=round(lease * 1e9))
    if deadline is not None:
        made.deadline = Duration(nanoseconds=round(deadline * 1e9))
    return made


def patiently(publisher: Any, message: Any) -> None:
    """Publish as soon as a history that keeps all has room again."""
    while True:
        try:
            publisher.publish(message)
        except Exception as error:
            if "cannot publish data" not in str(error):
                raise
        else:
            return


def done(future: Any) -> Any:
    """Wait for a future that the executor's thread completes."""
    completed = threading.Event()
    future.add_done_callback(lambda _: completed.set())
    assert completed.wait(PATIENCE)
    return future.result()


class Doer:
    """One method per operation; what it returns is the answer."""

    def __init__(self, node: Any) -> None:
        self.node = node
        self.publishers: dict[str, Any] = {}
        self.echoes: dict[str, Callable[[], None]] = {}
        self.latched: set[str] = set()
        self.octets: dict[str, Any] = {}
        self.seen: dict[str, list[Any]] = {}
        self.group = ReentrantCallbackGroup()
        self.ends: list[str] = []
        self.over = threading.Event()
        self.begun = threading.Event()
        self.executed = 0
        self.asked = threading.Event()
        self.gate = threading.Event()
        self.clients: dict[str, Any] = {}
        self.goals: list[Any] = []
        self.steps: list[list[list[int]]] = []

    def advertise(self, topic: str, kind: str = "Int64", **qos: Any) -> None:
        native = {"Int64": Int64, "Image": Image, "String": String}[kind]
        self.publishers[topic] = self.node.create_publisher(native, topic, profile(**qos))
        if qos.get("durability") == "transient_local":
            self.latched.add(topic)

    def redefine(self, kind: str = "Int64") -> None:
        """Define a type otherwise from now on."""
        redefine({"Int64": Int64, "Image": Image, "String": String}[kind])

    def redefine_reply(self) -> None:
        """Define what a service replies otherwise from now on."""
        redefine_reply(BasicTypes)

    def redefine_goal_reply(self) -> None:
        """Define how goals of an action are answered otherwise from now on."""
        redefine_goal_reply(Fibonacci)

    def unadvertise(self, topic: str) -> None:
        self.node.destroy_publisher(self.publishers.pop(topic))

    def publish(
        self,
        topic: str,
        count: int,
        first: int = 1,
        period: float = 0.0,
        size: int = 0,
        unmatched: bool = False,
    ) -> None:
        """Publish numbered messages, to a matched subscription unless they are latched.

        A subscription that has matched this publisher may be unknown to it for long on a busy
        machine; what is published until then never reaches it.
        """
        publisher = self.publishers[topic]
        if not unmatched and topic not in self.latched:
            deadline = time.monotonic() + PATIENCE
            while not publisher.get_subscription_count():
                assert time.monotonic() < deadline, f"no node subscribes to {topic}"
                time.sleep(0.001)
        payload = bytes(size)
        for number in range(first, first + count):
            if publisher.msg_type is Image:
                message = Image(height=number, width=1, step=size)
                message.data = payload
            elif publisher.msg_type is String:
                message = String(data=str(number))
            else:
                message = Int64(data=number)
            patiently(publisher, message)
            if period and self.over.wait(period):
                break

    def advertise_octets(self, topic: str, native: str) -> None:
        """Have a publisher of a type, `package/msg/Name`, whose messages are given as octets."""
        package, _, name = native.split("/")
        message_type = getattr(importlib.import_module(f"{package}.msg"), name)
        self.octets[topic] = self.node.create_publisher(message_type, topic, profile())

    def publish_octets(self, topic: str, octets: str) -> None:
        """Publish octets, given in hexadecimal digits, as a serialised message; once."""
        publisher = self.octets.pop(topic)
        deadline = time.monotonic() + PATIENCE
        while not publisher.get_subscription_count():
            assert time.monotonic() < deadline, f"no node subscribes to {topic}"
            time.sleep(0.001)
        publisher.publish(bytes.fromhex(octets))
        publisher.wait_for_all_acked(Duration(seconds=PATIENCE))
        self.node.destroy_publisher(publisher)

    def diagnose(self, entries: list[Any], count: int = 0, topic: str = "/diagnostics") -> None:
        """Publish an array of entries, and of so many others before, ten times a second."""
        from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue

        made = [
            DiagnosticStatus(
                name=name,
                level=bytes([level]),
                message=message,
                values=[KeyValue(key=key, value=value) for key, value in values.items()],
            )
            for name, level, message, values in entries
        ]
        others = [DiagnosticStatus(name=f"other {number}") for number in range(count)]
        self.array = DiagnosticArray(status=[*others, *made])
        if topic not in self.publishers:
            publisher = self.node.create_publisher(DiagnosticArray, topic, profile())
            self.publishers[topic] = publisher
            self.timer = self.node.create_timer(0.1, lambda: publisher.publish(self.array))

    def end_diagnosis(self) -> None:
        """Publish no more arrays, and stay."""
        self.timer.cancel()

    def subscribe(self, topic: str, kind: str = "Int64", **qos: Any) -> None:
        native = {"Int64": Int64, "Image": Image, "String": String}[kind]
        seen: list[Any] = []
        self.seen[topic] = seen

        def take(message: Any) -> None:
            seen.append(message.height if native is Image else message.data)

        self.node.create_subscription(native, topic, take, profile(**qos))

    def subscribe_timed(self, topics: list[str]) -> None:
        """Note what comes on several topics of numbers, with the times at which it was written.

        The order in which messages of two topics arrive says nothing; that of their times does.
        """
        self.timed: list[tuple[int, str, int]] = []
        for topic in topics:

            def take(message: Any, info: Any, topic: str = topic) -> None:
                self.timed.append((info["source_timestamp"], topic, message.data))

            self.node.create_subscription(Int64, topic, take, profile())

    def report_timed(self) -> Any:
        """Return what came so far on these topics, in the order in which it was written."""
        return [[topic, number] for _, topic, number in sorted(self.timed)]

    def report(self, topic: str, expected: int, timeout: float = PATIENCE) -> Any:
        """Return what has come once it is so much, or once nothing more comes for so long."""
        seen = self.seen[topic]
        before, deadline = len(seen), time.monotonic() + timeout
        while len(seen) < expected and time.monotonic() < deadline:
            time.sleep(0.01)
            if len(seen) > before:
                before, deadline = len(seen), time.monotonic() + timeout
        return list(seen)

    def subscriptions(self, topic: str, expected: int) -> Any:
        deadline = time.monotonic() + PATIENCE
        publisher = self.publishers[topic]
        while publisher.get_subscription_count() != expected and time.monotonic() < deadline:
            time.sleep(0.005)
        return publisher.get_subscription_count()

    def serve(self, name: str, delay: float = 0.0) -> None:
        def answer(request: Any, response: Any) -> Any:
            self.asked.set()
            time.sleep(delay)
            response.int64_value = request.int64_value + 1
            response.string_value = request.string_value[::-1]
            return response

        self.node.create_service(BasicTypes, name, answer, callback_group=self.group)

    def serve_flag(self, name: str) -> None:
        """Serve a name with another type than `serve` does."""
        self.node.create_service(SetBool, name, lambda _, response: response)

    def die(self, name: str) -> None:
        """Serve until the first request comes, and be killed by it."""

        def answer(request: Any, response: Any) -> Any:
            os.kill(os.getpid(), signal.SIGKILL)

        self.node.create_service(BasicTypes, name, answer, callback_group=self.group)

    def fail(self, name: str) -> None:
        """Serve as a node does whose callback raises: the exception ends the process."""

        def answer(request: Any, response: Any) -> Any:
            raise RuntimeError("this service is broken")

        self.node.create_service(BasicTypes, name, answer, callback_group=self.group)

    def echo(self, come: str, go: str) -> None:
        """Publish what comes; what comes before the first listener waits for it.

        A reader may know of this writer, and have sent a message by way of it, before this writer
        knows of the reader: the discovery of DDS goes both ways on its own.
        """
        everything = profile(history="keep_all")
        publisher = self.node.create_publisher(PoseStamped, go, everything)
        self.publishers[go] = publisher
        ended, publishing = threading.Event(), threading.Lock()

        def pass_on(message: Any) -> None:
            deadline = time.monotonic() + PATIENCE
            while True:
                with publishing:  # `end_echo` destroys the publisher from another thread
                    if ended.is_set():
                        return
                    if publisher.get_subscription_count() or time.monotonic() > deadline:
                        publisher.publish(message)
                        return
                time.sleep(0.001)

        subscription = self.node.create_subscription(PoseStamped, come, pass_on, everything)

        def end() -> None:
            self.node.destroy_subscription(subscription)
            with publishing:
                ended.set()
                self.node.destroy_publisher(self.publishers.pop(go))

        self.echoes[come] = end

    def end_echo(self, come: str) -> None:
        self.echoes.pop(come)()

    def pass_on(self, come: str, go: str, kind: str) -> None:
        """Publish what comes, of any type of test_msgs."""
        native = getattr(test_msgs.msg, kind)
        publisher = self.node.create_publisher(native, go, profile())
        self.node.create_subscription(native, come, publisher.publish, profile())

    def call(self, name: str, value: bool) -> dict[str, Any]:
        client = self.node.create_client(SetBool, name, callback_group=self.group)
        assert client.wait_for_service(PATIENCE)
        reply = client.call(SetBool.Request(data=value), PATIENCE)
        self.node.destroy_client(client)
        return {"success": reply.success, "message": reply.message}

    def manage(self, name: str, topic: str, fails: str = "") -> None:
        """Start a lifecycle node beside the first one."""
        self.managed = Numbers(name, topic, fails)
        self.node.executor.add_node(self.managed)

    def trigger(self, transition: str) -> None:
        """Change the state of the lifecycle node, as another client than the tested bridge does."""
        self.within(getattr(self.managed, f"trigger_{transition}"))

    def transitions(self, expected: int, timeout: float = PATIENCE) -> dict[str, Any]:
        """Wait until the lifecycle node was asked for so much."""
        deadline = time.monotonic() + timeout
        while len(self.managed.asked) < expected and time.monotonic() < deadline:
            time.sleep(0.01)
        return {
            "asked": list(self.managed.asked),
            "gains": self.managed.gains,
            "writes": self.managed.writes,
        }

    def act(self, name: str, period: float = 0.05, gated: bool = False) -> None:
        """Offer an action; gated, it answers no goal before `accept_goals`."""
        if not gated:
            self.gate.set()

        def judge(goal: Any) -> Any:
            self.asked.set()
            assert self.gate.wait(PATIENCE)
            return GoalResponse.REJECT if goal.order < 0 else GoalResponse.ACCEPT

        def execute(goal: Any) -> Any:
            self.executed += 1
            self.begun.set()
            sequence = [0, 1]
            for _ in range(1, goal.request.order):
                if goal.is_cancel_requested:
                    goal.canceled()
                    self.ends.append("canceled")
                    return Fibonacci.Result(sequence=sequence)
                sequence.append((sequence[-1] + sequence[-2]) % 2**31)  # int32, in long goals too
                goal.publish_feedback(Fibonacci.Feedback(sequence=sequence))
                if self.over.wait(period):
                    break
            self.ends.append("completed")
            if goal.request.order == 13:
                goal.abort()
            else:
                goal.succeed()
            return Fibonacci.Result(sequence=sequence)

        self.server = ActionServer(
            self.node,
            Fibonacci,
            name,
            execute,
            callback_group=self.group,
            goal_callback=judge,
            cancel_callback=lambda _: CancelResponse.ACCEPT,
        )

    def within(self, act: Any) -> Any:
        """Do something in the executor's thread: an action client drops answers that come sooner.

        It notes that it waits for one after it has sent what is answered.
        """
        return done(self.node.executor.create_task(act))

    def meet(self, name: str) -> Any:
        """Make a client of an action, and see its server."""
        client = ActionClient(self.node, Fibonacci, name, callback_group=self.group)
        self.clients[name] = client
        return client.wait_for_server(PATIENCE)

    def pursue(self, name: str, order: int) -> dict[str, Any]:
        """Send a goal, as an ordinary action client does, and wait for its answer."""
        client, steps = self.clients[name], list[list[int]]()

        def take(message: Any) -> None:
            steps.append(list(message.feedback.sequence))

        goal = Fibonacci.Goal(order=order)
        handle = done(self.within(lambda: client.send_goal_async(goal, take)))
        self.goals.append(handle)
        self.steps.append(steps)
        return {"goal": len(self.goals) - 1, "accepted": handle.accepted}

    def pursue_many(self, name: str, count: int, at_once: int) -> dict[str, int]:
        """Send many goals, some at a time, of which every fifth is cancelled; count their ends."""
        client, ends, orders = self.clients[name], list[int](), iter(range(count))
        over = threading.Event()

        def send() -> None:
            order = next(orders, None)
            if order is not None:
                goal = Fibonacci.Goal(order=order)
                sent = client.send_goal_async(goal)
                sent.add_done_callback(lambda item: answered(order, item.result()))

        def answered(order: int, handle: Any) -> None:
            if not handle.accepted:
                ended(0)
                return
            result = handle.get_result_async()
            result.add_done_callback(lambda item: ended(item.result().status))
            if order % 5 == 4:
                handle.cancel_goal_async()

        def ended(status: int) -> None:
            ends.append(status)
            if len(ends) == count:
                over.set()
            send()

        for _ in range(at_once):
            self.within(send)
        assert over.wait(PATIENCE), f"{len(ends)} of {count} goals ended"
        return {str(status): ends.count(status) for status in set(ends)}

    def feedback(self, goal: int, expected: int) -> Any:
        deadline = time.monotonic() + PATIENCE
        while len(self.steps[goal]) < expected and time.monotonic() < deadline:
            time.sleep(0.01)
        return self.steps[goal]

    def give_up(self, goal: int) -> dict[str, Any]:
        """Ask for the end of a goal."""
        reply = done(self.within(self.goals[goal].cancel_goal_async))
        return {"canceling": len(reply.goals_canceling), "code": reply.return_code}

    def outcome(self, goal: int) -> dict[str, Any]:
        """Wait for the result of a goal."""
        reply = done(self.within(self.goals[goal].get_result_async))
        return {"status": reply.status, "sequence": list(reply.result.sequence)}

    def goal_asked(self) -> Any:
        return self.asked.wait(PATIENCE)

    def accept_goals(self) -> None:
        self.gate.set()

    def goals_begun(self) -> Any:
        return self.executed

    def request_begun(self) -> Any:
        return self.asked.wait(PATIENCE)

    def goal_begun(self) -> Any:
        return self.begun.wait(PATIENCE)

    def goal_ends(self) -> Any:
        deadline = time.monotonic() + PATIENCE
        while not self.ends and time.monotonic() < deadline:
            time.sleep(0.01)
        return self.ends


def say(answer: dict[str, Any]) -> None:
    print(json.dumps(answer), flush=True)  # noqa: T201 - the answer


def listen(doer: Doer, orders: queue.SimpleQueue[dict[str, Any] | None]) -> None:
    """Pass on orders as they come; at their end what still publishes stops."""
    for line in sys.stdin:
        orders.put(json.loads(line))
    doer.over.set()
    orders.put(None)


def obey(doer: Doer) -> None:
    orders: queue.SimpleQueue[dict[str, Any] | None] = queue.SimpleQueue()
    threading.Thread(target=listen, args=(doer, orders), daemon=True).start()
    say({"is": "ready"})
    while (order := orders.get()) is not None:
        operation = getattr(doer, order.pop("do"))
        try:
            say({"is": operation(**order)})
        except Exception as error:  # noqa: BLE001 - reported to the test
            say({"raised": repr(error)})
    rclpy.try_shutdown()


def main() -> None:
    rclpy.init(args=[])
    described = Parameter("start_type_description_service", value="silent" not in sys.argv)
    node = Node(sys.argv[1], parameter_overrides=[described])
    threads = "threads" in sys.argv
    executor = MultiThreadedExecutor(num_threads=4) if threads else SingleThreadedExecutor()
    executor.add_node(node)
    threading.Thread(target=obey, args=(Doer(node),), daemon=True).start()
    with suppress(KeyboardInterrupt, ExternalShutdownException):
        executor.spin()


if __name__ == "__main__":
    main()
