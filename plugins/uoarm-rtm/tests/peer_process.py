"""A real RT-Component in a process of its own, driven by lines on standard input.

It binds itself as NAME.rtc and has an OutPort `out`, an InPort `in` and a counter of what came.
Answers are lines of JSON on standard output. It ends when standard input does.
"""

from __future__ import annotations

import json
import os
import queue
import sys
import threading
from collections.abc import Mapping
from typing import Any

from _uoarm_rtm_stubs import RTC, OpenRTM, SDOPackage
from endpoints import HANGS_AFTER
from plain import plain
from uoarm_rtm import _data_ports
from uoarm_rtm._data_ports import InPort, OutPort
from uoarm_rtm._dataflow import PullBuffer
from uoarm_rtm._descriptors import IdlInterface
from uoarm_rtm._naming import NamingService
from uoarm_rtm._orb import Orb, narrowed
from uoarm_rtm._peer import pairs, peer_at, properties_of
from uoarm_rtm._port_servant import ConnectorRefusal, PortServant
from uoarm_rtm._services import ServicePort, servant_of
from uoarm_rtm._types import Types
from uoarm_rtm.component import Callbacks, ComponentProfile, RtComponent
from uoarm_rtm.errors import IdlError

from uoarm.testing import patience

LIMIT = 2 * HANGS_AFTER  # longer than the bridges of tests about what hangs wait
SETS = {
    "default": {"gain": "1", "mode": "slow"},
    "fast": {"gain": "9"},
    "plain": {"count": "0", "name": "hoge"},
    "__constraints__": {"gain": "0<=x<=150", "mode": "(slow,quick)"},
    "__widget__": {"gain": "slider.10"},
}


class Wanted(PortServant):
    """A CorbaPort that requires one interface."""

    def __init__(self, orb: Orb, name: str, interface: IdlInterface) -> None:
        super().__init__(orb, name, {"port.port_type": "CorbaPort"}, LIMIT)
        self._interface = interface
        kind = interface.name.split("/")[-1]
        self._key = f"port.{kind}.{kind.lower()}"
        self.interfaces = [RTC.PortInterfaceProfile(kind.lower(), kind, RTC.REQUIRED)]
        self._object: Any = None

    def ask(self, operation: str, arguments: Any) -> Any:
        chosen = self._interface.operation(operation)
        return chosen.reply(getattr(self._object, operation)(*chosen.arguments(arguments)))

    def _publish(self, profile: Any) -> None:
        pass

    def _subscribe(self, profile: Any) -> None:
        ior = properties_of(profile.properties)[self._key]
        self._object = narrowed(self.orb.reference(ior), self._interface.stub, LIMIT, self.name)

    def _release(self, connector_id: str) -> None:
        self._object = None


class Asked(PullBuffer):
    """A buffer that knows how many are asking it."""

    asking = 0

    def get(self) -> tuple[Any, bytes]:
        Asked.asking += 1
        try:
            return super().get()
        finally:
            Asked.asking -= 1


class _Service:
    """What the operations of tests/service.idl do."""

    def __init__(self) -> None:
        self.awake = threading.Event()
        self.sleeping: list[None] = []  # one for each call

    def answer(self, message: Any) -> Any:
        operation, arguments = message["operation"], message["arguments"]
        if operation == "move":
            if arguments["target"]["x"] > 1.0:
                members = {"limit": 1.0, "why": "too far"}
                raise IdlError("too far", "IDL:Arm/OutOfReach:1.0", members)
            return {
                "return": arguments["target"]["x"],
                "steps": arguments["steps"] + 1,
                "path": [1.0],
            }
        if operation == "stuck":
            self.awake.wait()
        if operation == "sleep":
            self.sleeping.append(None)
            self.awake.wait(arguments["seconds"])
            return {}
        if operation == "echo":
            return {"return": arguments["words"]}
        raise RuntimeError(operation)


class Process:
    """The component and the commands that it obeys, one method each."""

    def __init__(self, nameserver: str, name: str, type_id: str, idl: str) -> None:
        most_octets = int(os.environ.get("PEER_MOST_OCTETS", "268435456"))
        self._orb = Orb("127.0.0.1", LIMIT, most_octets)
        self._types = Types([idl] if idl else [])
        self._received: list[Any] = []
        self._calls: list[str] = []
        self._fail = ""
        self._free = threading.Event()
        self._free.set()
        self._held = threading.Event()
        self._may_connect = threading.Event()
        self._may_connect.set()
        self._made_in_all = 0
        self._configured: dict[str, str] = {}
        self._observers: dict[str, Any] = {}
        self._asked_to_observe = 0
        self._service = _Service()
        self._loops: dict[str, tuple[InPort, OutPort, queue.Queue[Any]]] = {}
        callbacks = Callbacks(
            activated=lambda: self._called("activated"),
            deactivated=lambda: self._called("deactivated"),
            aborting=lambda: self._called("aborting"),
            reset=lambda: self._called("reset"),
        )
        profile = ComponentProfile(name, configuration=SETS)
        self._component = RtComponent(
            self._orb, profile, callbacks=callbacks, configured=self._take_configuration
        )
        self._in = self._component.add_in_port("in", type_id, self._types, self._take)
        self._out = self._component.add_out_port("out", type_id, self._types)
        self._count_connections()
        path = name if name.endswith(".rtc") else f"{name}.rtc"
        self._component.bind([NamingService(self._orb, nameserver, LIMIT)], path)

    def write(self, message: Any) -> None:
        self._out.write(message)

    def count(self, start: int, stop: int) -> None:
        for number in range(start, stop):
            self._out.write({"tm": {"sec": number, "nsec": 0}, "data": number})

    def received(self) -> list[Any]:
        return self._received

    def sizes(self) -> list[int]:
        return [len(item["data"]) for item in self._received]

    def dropped(self) -> int:
        return self._out.dropped

    def write_octets(self, size: int) -> None:
        self._out.write({"tm": {"sec": 1, "nsec": 0}, "data": bytes(size)})

    def fetch(self) -> int:
        return self._in.fetch()

    def hold(self) -> None:
        """Let a writer to the InPort wait, from the next message on."""
        self._free.clear()
        self._held.clear()

    def held(self) -> bool:
        """Wait until a writer waits; returns whether that came."""
        return self._held.wait(patience())

    def release(self) -> None:
        self._free.set()

    def hold_connections(self) -> None:
        """Let a client that connects to the OutPort wait, before the connection is made."""
        self._may_connect.clear()

    def let_connect(self) -> None:
        self._may_connect.set()

    def made_in_all(self) -> int:
        """Return how many connections of the OutPort were made, of which some may have ended."""
        return self._made_in_all

    def _count_connections(self) -> None:
        connect = self._out.notify_connect

        def count(profile: Any) -> Any:
            self._may_connect.wait(patience())
            answer = connect(profile)
            self._made_in_all += answer[0] == RTC.RTC_OK
            return answer

        setattr(self._out, "notify_connect", count)  # noqa: B010 - of this instance alone

    def calls(self) -> list[str]:
        return self._calls

    def fail(self, name: str) -> None:
        self._fail = name

    def abort(self) -> None:
        self._component.lifecycle.fail()

    def configuration(self) -> dict[str, str]:
        return self._configured

    def connectors(self) -> list[int]:
        ports = (self._in, self._out)
        return [len(port.get_connector_profiles()) for port in ports]

    def made(self) -> list[dict[str, str]]:
        """The properties of all connectors."""
        ports = (self._in, self._out)
        found = [profile for port in ports for profile in port.get_connector_profiles()]
        return [properties_of(item.properties) for item in found]

    def speak(self, language: str) -> None:
        """Say in the profile which language it is written in."""
        usual = self._component.get_component_profile

        def profile() -> Any:
            found = usual()
            found.properties = pairs({"language": language})
            return found

        setattr(self._component, "get_component_profile", profile)  # noqa: B010 - of this instance

    def port_says(self, port: str, name: str, value: str) -> None:
        """Say something else in the profile of `in` or `out`."""
        {"in": self._in, "out": self._out}[port].properties[name] = value

    def mind_disconnecting(self) -> None:
        """Count the calls that ask the OutPort while it is being disconnected."""
        setattr(_data_ports, "PullBuffer", Asked)  # noqa: B010 - typed as what it stands in for
        release, self._interrupted = getattr(self._out, "_release"), 0  # noqa: B009 - private

        def spy(connector_id: str) -> None:
            self._interrupted += Asked.asking
            release(connector_id)

        setattr(self._out, "_release", spy)  # noqa: B010 - of this instance alone

    def mind_connections(self) -> None:
        """Refuse a connection that another of its ports has already, as 1.2 in Python does."""
        publish = getattr(self._in, "_publish")  # noqa: B009 - private

        def compare(profile: Any) -> None:
            for connector_profile in profile.ports[0].get_connector_profiles():
                if connector_profile.connector_id == profile.connector_id:
                    raise ConnectorRefusal("it is there already", RTC.PRECONDITION_NOT_MET)
            publish(profile)

        setattr(self._in, "_publish", compare)  # noqa: B010 - of this instance alone

    def ask_the_other_port(self) -> None:
        """Answer for the OutPort's connectors with what the other port says, as Python does."""
        usual = self._out.get_connector_profile

        def asked(connector_id: str) -> Any:
            profile = usual(connector_id)
            for port in profile.ports[1:]:
                port.get_port_profile()
            return profile

        setattr(self._out, "get_connector_profile", asked)  # noqa: B010 - of this instance alone

    def forget_sets(self) -> None:
        """Have no active set after a write, and forget new sets, as OpenRTM does."""
        servant = getattr(self._component, "_configuration")  # noqa: B009 - private
        write, active = servant.set_configuration_set_values, servant.get_active_configuration_set
        activate = servant.activate_configuration_set
        self._no_set = False

        def written(configuration_set: Any) -> bool:
            self._no_set = True
            return bool(write(configuration_set))

        def activated(name: str) -> bool:
            self._no_set = False
            return bool(activate(name))

        def read() -> Any:
            if self._no_set:
                raise SDOPackage.NotAvailable("none")
            return active()

        servant.set_configuration_set_values = written
        servant.activate_configuration_set = activated
        servant.get_active_configuration_set = read
        servant.add_configuration_set = lambda _: True

    def take_observers(self, answer: bool = True) -> None:
        """Take observers and notify them of states, as OpenRTM does; or answer that it does not."""
        servant = getattr(self._component, "_configuration")  # noqa: B009 - private
        lifecycle = self._component.lifecycle
        enter = lifecycle._enter

        def add(profile: Any) -> bool:
            self._asked_to_observe += 1
            if answer:
                self._observers[profile.id] = profile
            return answer

        def notify(state: Any) -> None:
            enter(state)
            hint = f"{str(state).removesuffix('_STATE')}:0"
            for observer in list(self._observers.values()):
                service = observer.service._narrow(OpenRTM.ComponentObserver)
                service.update_status(OpenRTM.RTC_STATUS, hint)

        setattr(lifecycle, "_enter", notify)  # noqa: B010 - of this instance alone
        servant.add_service_profile = add
        servant.remove_service_profile = lambda name: self._observers.pop(name, None) is not None

    def observers(self) -> list[dict[str, str]]:
        return [properties_of(observer.properties) for observer in self._observers.values()]

    def asked_to_observe(self) -> int:
        return self._asked_to_observe

    def asked(self) -> int:
        return Asked.asking

    def interrupted(self) -> int:
        return self._interrupted

    def refuse(self) -> None:
        """Let every later connection fail after the port has published what it offers."""

        def fail(profile: Any) -> None:
            raise self._refusal

        self._refusal = ConnectorRefusal("half-way", RTC.OUT_OF_RESOURCES)
        for port in (self._in, self._out):
            setattr(port, "_subscribe", fail)  # noqa: B010 - of this instance alone

    def provide(self, idl: str, interface: str) -> None:
        """Add a CorbaPort `served` whose operations are those of `_Service`."""
        types = Types([idl])
        found, _ = types.interface(interface)
        name = f"{self._component.profile.name}.served"
        servant = servant_of(found, "", self._service.answer)
        self._component.add_port(ServicePort(self._orb, name, found, servant, 2.0))

    def sleepers(self) -> int:
        """Return how many calls began to sleep."""
        return len(self._service.sleeping)

    def wake(self) -> None:
        """Let the operations that sleep or are stuck answer."""
        self._service.awake.set()

    def require(self, idl: str, interface: str) -> None:
        """Add a CorbaPort `wanted` that calls what is connected to it."""
        types = Types([idl])
        found, _ = types.interface(interface)
        self._wanted = Wanted(self._orb, f"{self._component.profile.name}.wanted", found)
        self._component.add_port(self._wanted)

    def ask(self, operation: str, arguments: Any) -> Any:
        return self._wanted.ask(operation, arguments)

    def join(self, nameserver: str, path: str, port: str) -> str:
        """Connect `wanted` to a port of another component that provides its interface."""
        found = peer_at(path, NamingService(self._orb, nameserver, LIMIT).resolve(path), LIMIT)
        ports = [found.port(port).reference, self._wanted.reference]
        code, _ = ports[0].connect(RTC.ConnectorProfile("tool", "", ports, []))
        return str(code)

    def connect(self, nameserver: str, path: str, port: str, properties: dict[str, str]) -> str:
        """Connect our OutPort to an InPort of another component, as a tool would."""
        found = peer_at(path, NamingService(self._orb, nameserver, LIMIT).resolve(path), LIMIT)
        ports = [self._out.reference, found.port(port).reference]
        profile = RTC.ConnectorProfile("tool", "", ports, pairs(properties))
        code, _ = self._out.connect(profile)
        return str(code)

    def loop(self, name: str, type_id: str, rate: float) -> None:
        """Add ports `NAME_in` and `NAME_out`: what comes in goes out, from another thread.

        OutPorts that wait to be asked are asked `rate` times a second.
        """
        out = self._component.add_out_port(f"{name}_out", type_id, self._types)
        waiting: queue.Queue[Any] = queue.Queue(100)
        into = self._component.add_in_port(f"{name}_in", type_id, self._types, waiting.put, rate)
        self._loops[name] = into, out, waiting

        def forward() -> None:
            while (message := waiting.get()) is not None:
                out.write(message)

        threading.Thread(target=forward, daemon=True).start()

    def end_loop(self, name: str) -> None:
        """Remove the ports of a loop, with what has not gone out yet."""
        into, out, waiting = self._loops.pop(name)
        for port in (into, out):
            self._component.remove_port(port)
        waiting.put(None)

    def emit_octets(self, name: str, digits: str) -> None:
        """Send octets as they are, given in hexadecimal digits, through `NAME_out`."""
        _, out, _ = self._loops[name]
        for outlet in list(getattr(out, "_outlets").values()):  # noqa: B009 - private
            outlet.writer.write(bytes.fromhex(digits))

    def vanish(self) -> None:
        """Be gone at once, as when the process is killed: neither name nor connections end."""
        for _, _, waiting in self._loops.values():
            waiting.put(None)
        self.wake()
        self._orb.close()

    def activate(self) -> None:
        self._component.lifecycle.activate()

    def deactivate(self) -> None:
        self._component.lifecycle.deactivate()

    def state(self) -> str:
        return str(self._component.lifecycle.state)

    def cut(self) -> None:
        for port in (self._in, self._out):
            port.disconnect_all()

    def forget(self) -> None:
        """Drop all connections on our side alone, as a component does whose write fails."""
        for port in (self._in, self._out):
            for profile in port.get_connector_profiles():
                port.drop(profile.connector_id)

    def close(self) -> None:
        self.wake()
        self._component.close()
        self._orb.close()

    def _take(self, message: Any) -> None:
        self._held.set()
        self._free.wait(patience())
        self._received.append(plain(message))

    def _called(self, name: str) -> None:
        self._calls.append(name)
        if self._fail == name:
            raise RuntimeError(name)

    def _take_configuration(self, values: Mapping[str, str]) -> None:
        self._configured = dict(values)


def _say(answer: Any) -> None:
    sys.stdout.write(json.dumps({"is": answer}) + "\n")
    sys.stdout.flush()


def main() -> None:
    process = Process(*sys.argv[1:5])
    _say("ready")
    for line in sys.stdin:
        command, *arguments = json.loads(line)
        if command == "appear":  # after `vanish`, as if the program was started again
            process = Process(*sys.argv[1:5])
            _say(None)
            continue
        _say(getattr(process, command)(*arguments))
    process.close()


if __name__ == "__main__":
    main()
