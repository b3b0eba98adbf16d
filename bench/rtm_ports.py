"""Data ports of an RT-Component: through uoarm, and with a bare omniORBpy client on the same peer.

The peer is a component in a process of its own that gives back what it gets, within the call: a
round trip is one `put` to it with one `put` from it inside.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from typing import Any

from bench.tables import microseconds, print_table, row
from bench.turns import module, running

TM = {"sec": 1, "nsec": 2}
SIZE = {"width": 1000, "height": 1000, "bpp": 8, "format": "mono8", "fDiv": 0.0}
SMALL, LARGE = "IDL:RTC/TimedLong:1.0", "IDL:RTC/CameraImage:1.0"
MESSAGES: dict[str, Any] = {
    SMALL: {"tm": TM, "data": 7},
    LARGE: {"tm": TM, **SIZE, "pixels": bytes(1_000_000)},
}
REPEAT = {SMALL: 3000, LARGE: 200}
PORTS = {SMALL: "small", LARGE: "large"}
WHAT = {SMALL: "TimedLong", LARGE: "CameraImage, 1 MB"}


def main() -> int:
    """Print the tables; 0 also when there is no omniORB to measure."""
    try:
        from uoarm_rtm.nameserver import NameServer  # noqa: PLC0415
    except ImportError as error:
        print(f"no port table: {error}", file=sys.stderr)
        return 0
    with NameServer() as names, running(module("bench.rtm_ports", "serve", names.address)) as peer:
        peer.said("(ready)")
        _tables(names.address)
    return 0


def _tables(address: str) -> None:
    put, around = [], []
    for kind, message in MESSAGES.items():
        for name, measure in (("bare omniORBpy", _bare), ("uoarm bridge", _bridge)):
            one_way = measure(address, kind, message, echo=False)
            both_ways = measure(address, kind, message, echo=True)
            put.append(row(f"{name}, {WHAT[kind]}", one_way))
            around.append(row(f"{name}, {WHAT[kind]}", both_ways))
    head = ("client", "median", "p99", "")
    print_table("`put` to an InPort (us)", head, put)
    print_table("`put` and the delivery of an OutPort within it (us)", head, around)


def _bare(address: str, kind: str, message: Any, *, echo: bool) -> list[float]:
    """Measure what one would write by hand: stubs, omniORB's marshalling, one connector each."""
    import omniORB  # noqa: PLC0415
    from _uoarm_rtm_stubs import RTC, OpenRTM, OpenRTM__POA  # noqa: PLC0415
    from uoarm_rtm._naming import NamingService  # noqa: PLC0415
    from uoarm_rtm._options import RtmEndpointOptions  # noqa: PLC0415
    from uoarm_rtm._orb import Orb  # noqa: PLC0415
    from uoarm_rtm._peer import (  # noqa: PLC0415
        Connections,
        connector_properties,
        peer_at,
    )

    orb = Orb("127.0.0.1", 5.0)
    peer = peer_at("Echo0.rtc", NamingService(orb, address, 5.0).resolve("Echo0.rtc"), 5.0)
    name = kind.split("/")[1].split(":", maxsplit=1)[0]
    code = getattr(RTC, f"_tc_{name}")
    seen = [0]

    class Inlet(OpenRTM__POA.InPortCdr):  # type: ignore[misc]  # generated
        def put(self, data: bytes) -> Any:
            omniORB.cdrUnmarshal(code, data, True)
            seen[0] += 1
            return OpenRTM.PORT_OK

    properties = connector_properties(RtmEndpointOptions(), kind)
    connections = Connections(orb, "bench", 5.0)
    into = connections.connect("peer", properties, peer.port(f"{PORTS[kind]}_in"))
    key = "dataport.corba_cdr.inport_ior"
    target = orb.reference(into.properties[key])._narrow(OpenRTM.InPortCdr)  # noqa: SLF001
    back = None
    if echo:
        inlet = orb.serve(Inlet())
        port = peer.port(f"{PORTS[kind]}_out")
        back = connections.connect("peer", {**properties, key: orb.text(inlet)}, port)
    values = {**message, "tm": RTC.Time(**message["tm"])}
    native = getattr(RTC, name)(**values)

    def send() -> None:
        target.put(omniORB.cdrMarshal(code, native, True))

    samples = _samples(send, kind, seen if echo else None)
    for connector in (into, back):
        if connector is not None:
            connector.disconnect()
    orb.close()
    return samples


def _bridge(address: str, kind: str, message: Any, *, echo: bool) -> list[float]:
    from uoarm.bridge import Registry  # noqa: PLC0415
    from uoarm.model import BridgeSpec, Endpoint, Role  # noqa: PLC0415

    bridge = Registry().create(BridgeSpec("rtm", "rtm", {"nameserver": address}))
    seen = [0]

    def take(_: Any) -> None:
        seen[0] += 1

    into = Endpoint("rtm", "echo", Role.INPUT, ("Echo0.rtc", f"{PORTS[kind]}_in"))
    back = Endpoint("rtm", "echo", Role.OUTPUT, ("Echo0.rtc", f"{PORTS[kind]}_out"))
    structure = bridge.describe(into).message
    assert structure is not None
    if echo:
        bridge.open_source(back, structure, take)
    sink = bridge.open_sink(into, structure)
    samples = _samples(lambda: sink.send(message), kind, seen if echo else None)
    bridge.close()
    return samples


def _samples(send: Callable[[], object], kind: str, seen: list[int] | None) -> list[float]:
    for _ in range(20):
        send()
    samples = microseconds(send, repeat=REPEAT[kind])
    assert seen is None or seen[0] == REPEAT[kind] + 20
    return samples


def serve(address: str) -> None:
    """Be the peer until standard input ends."""
    from uoarm_rtm.component import (  # noqa: PLC0415
        ComponentProfile,
        NamingService,
        Orb,
        RtComponent,
        Types,
    )

    orb, types = Orb("127.0.0.1", 5.0), Types()
    component = RtComponent(orb, ComponentProfile("Echo0"))
    for kind, name in PORTS.items():
        out = component.add_out_port(f"{name}_out", kind, types)
        component.add_in_port(f"{name}_in", kind, types, out.write)
    component.lifecycle.activate()
    component.bind([NamingService(orb, address, 5.0)])
    print("ready", flush=True)
    sys.stdin.read()
    component.close()
    orb.close()


if __name__ == "__main__":
    if len(sys.argv) > 2 and sys.argv[1] == "serve":
        serve(sys.argv[2])
    else:
        sys.exit(main())
