"""A real RT-Component in a process of its own, driven by lines on standard input.

It binds itself as NAME.rtc and has an OutPort `out`, an InPort `in` and a counter of what came.
Answers are lines of JSON on standard output. It ends when standard input does.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Mapping
from typing import Any

from plain import plain
from uoarm_rtm._naming import NamingService
from uoarm_rtm._orb import Orb
from uoarm_rtm._types import Types
from uoarm_rtm.component import Callbacks, RtComponent, Sheet


class Process:
    """The component and the commands that it obeys, one method each."""

    def __init__(self, nameserver: str, name: str, type_id: str, idl: str) -> None:
        self._orb = Orb("127.0.0.1", 2.0)
        self._types = Types([idl] if idl else [])
        self._received: list[Any] = []
        self._calls: list[str] = []
        self._fail = ""
        self._configured: dict[str, str] = {}
        callbacks = Callbacks(
            activated=lambda: self._called("activated"),
            deactivated=lambda: self._called("deactivated"),
            aborting=lambda: self._called("aborting"),
            reset=lambda: self._called("reset"),
        )
        sheet = Sheet(name, configuration={"default": {"gain": "1"}, "fast": {"gain": "9"}})
        self._component = RtComponent(
            self._orb, sheet, callbacks=callbacks, configured=self._take_configuration
        )
        self._in = self._component.add_in_port("in", type_id, self._types, self._take)
        self._out = self._component.add_out_port("out", type_id, self._types)
        path = name if name.endswith(".rtc") else f"{name}.rtc"
        self._component.bind([NamingService(self._orb, nameserver, 2.0)], path)

    def write(self, message: Any) -> None:
        self._out.write(message)

    def count(self, start: int, stop: int) -> None:
        for number in range(start, stop):
            self._out.write({"tm": {"sec": number, "nsec": 0}, "data": number})

    def received(self) -> list[Any]:
        return self._received

    def fetch(self) -> int:
        return self._in.fetch()

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

    def refuse(self) -> None:
        """Let every later connection fail after the port has published what it offers."""

        def fail(profile: Any) -> None:
            raise self._refusal

        from uoarm_rtm._stubs import RTC
        from uoarm_rtm._wishes import Refusal

        self._refusal = Refusal("half-way", RTC.OUT_OF_RESOURCES)
        for port in (self._in, self._out):
            vars(port)["_subscribe"] = fail

    def cut(self) -> None:
        for port in (self._in, self._out):
            port.disconnect_all()

    def close(self) -> None:
        self._component.close()
        self._orb.close()

    def _take(self, message: Any) -> None:
        self._received.append(plain(message))

    def _called(self, name: str) -> None:
        self._calls.append(name)
        if self._fail == name:
            raise RuntimeError(name)

    def _take_configuration(self, values: Mapping[str, str]) -> None:
        self._configured = dict(values)


def _say(answer: Any) -> None:
    sys.stdout.write(json.dumps(answer) + "\n")
    sys.stdout.flush()


def main() -> None:
    process = Process(*sys.argv[1:5])
    _say("ready")
    for line in sys.stdin:
        command, *arguments = json.loads(line)
        _say(getattr(process, command)(*arguments))
    process.close()


if __name__ == "__main__":
    main()
