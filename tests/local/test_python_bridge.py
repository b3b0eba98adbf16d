"""Plain Python components: hints become structures, mistakes become one clear error."""

from __future__ import annotations

import json
import threading
from collections.abc import Iterator
from typing import Annotated, Any, Literal, TypedDict

import pytest
from typing_extensions import NotRequired

from uoarm import RobotManager
from uoarm._support.workers import WorkerPool
from uoarm.config import loads
from uoarm.errors import BridgeError, FailureReason, MessageError
from uoarm.local import (
    HintError,
    Octets,
    PythonBridge,
    PythonOptions,
    Range,
    UInt8,
    schema_of,
    structure,
)
from uoarm.local._instance import Instance
from uoarm.local._loop import Coroutines, LoopThread
from uoarm.local._target import Target
from uoarm.model import Endpoint, MessageStructure, Role
from uoarm.testing import Background, patience, wait

HERE = "tests.local.test_python_bridge"


class Inner(TypedDict):
    x: UInt8
    note: NotRequired[str]


class Whole(TypedDict):
    inner: Inner
    data: Octets
    kind: Literal["a", "b"]
    many: list[Annotated[float, Range(0)]]
    pair: tuple[int, bool]
    maybe: int | None


def source() -> Iterator[Inner]:
    yield {"x": 1}


def change(message: Inner, factor: int = 1) -> Inner | None:
    return {"x": message["x"] * factor}


def count_fields(message: dict[str, Any]) -> int:
    return len(message)


def unhinted(message):  # type: ignore[no-untyped-def] # on purpose  # noqa: ANN001, ANN201
    return message


NOT_CALLABLE = 7


class Queue:
    """A service with something to do between its calls."""

    open_ones = 0

    def __init__(self) -> None:
        Queue.open_ones += 1
        self.taken = 0

    def __call__(self, message: Inner) -> Inner:
        self.taken += message["x"]
        return {"x": self.taken}

    def close(self) -> None:
        Queue.open_ones -= 1


def describe(name: str, role: Role, **parameters: Any) -> Any:
    endpoint = Endpoint("p", "c", role, (name,), parameters=parameters)
    bridge = PythonBridge("p", PythonOptions())
    try:
        return bridge.describe(endpoint)
    finally:
        bridge.close()


def test_a_service_is_built_once_and_closed_with_the_bridge() -> None:
    bridge = PythonBridge("p", PythonOptions())
    endpoint = Endpoint("p", "queue", Role.SERVICE, (f"{HERE}:Queue",))
    answers = [bridge.call(endpoint, {"x": 2}, timeout=patience()) for _ in range(3)]
    assert answers == [{"x": 2}, {"x": 4}, {"x": 6}]
    assert Queue.open_ones == 1
    bridge.close()
    assert Queue.open_ones == 0


class Slow(Queue):
    """One that is built while its bridge closes."""

    begun, go_on = threading.Event(), threading.Event()

    def __init__(self) -> None:
        self.begun.set()
        assert self.go_on.wait(patience())
        super().__init__()


def test_a_service_that_is_built_as_the_bridge_closes_is_closed_after_its_call() -> None:
    bridge = PythonBridge("p", PythonOptions())
    endpoint = Endpoint("p", "slow", Role.SERVICE, (f"{HERE}:Slow",))
    call = Background(lambda: bridge.call(endpoint, {"x": 2}, timeout=patience()))
    assert Slow.begun.wait(patience())
    bridge.close()
    Slow.go_on.set()
    call.result()
    assert Queue.open_ones == 0


def test_hints_become_closed_objects_with_required_fields() -> None:
    schema: Any = schema_of(Whole)
    assert schema["additionalProperties"] is False
    assert schema["required"] == ["inner", "data", "kind", "many", "pair", "maybe"]
    fields = schema["properties"]
    assert fields["inner"]["required"] == ["x"]
    assert fields["inner"]["properties"]["x"] == {"type": "integer", "minimum": 0, "maximum": 255}
    assert fields["data"]["x-octets"] is True
    assert fields["kind"] == {"enum": ["a", "b"]}
    assert fields["maybe"] == {"anyOf": [{"type": "integer"}, {"type": "null"}]}
    assert fields["pair"]["minItems"] == 2


def test_a_hint_without_a_structure_is_named() -> None:
    with pytest.raises(HintError, match="complex"):
        schema_of(complex)


def test_a_function_is_described_from_both_ends() -> None:
    taken = describe(f"{HERE}:change", Role.INPUT).message
    given = describe(f"{HERE}:change", Role.OUTPUT).message
    assert taken == given
    assert describe(f"{HERE}:source", Role.OUTPUT).message == taken


@structure(
    output={"$schema": "http://json-schema.org/draft-07/schema#", "dependencies": {"a": ["b"]}},
    input={"$schema": "http://json-schema.org/draft-03/schema#"},
)
def declared(message: Any) -> Any:
    return message


def test_a_structure_of_an_older_draft_is_described_in_the_newest() -> None:
    found = describe(f"{HERE}:declared", Role.OUTPUT).message
    assert found == MessageStructure({"dependentRequired": {"a": ["b"]}})
    with pytest.raises(BridgeError, match=r"declared: its structure of input .* draft 04, 06"):
        describe(f"{HERE}:declared", Role.INPUT)


def test_what_has_no_hint_has_no_structure() -> None:
    assert describe(f"{HERE}:unhinted", Role.OUTPUT).message is None


def test_what_a_hint_leaves_open_the_configuration_may_declare() -> None:
    said = describe(f"{HERE}:count_fields", Role.INPUT)
    assert said.message is None
    assert said.hint.startswith(f"have {HERE}:count_fields say what is in dict[str, ")
    needed: Any = {"type": "object", "properties": {"x": {"type": "number"}}, "required": ["x"]}
    part: dict[str, Any] = {"endpoint": [f"{HERE}:count_fields"]}
    component = {"name": "c", "bridge": "python", "output": part}
    whole = {"version": 1, "bridges": {"python": {}}}
    counts = {"components": [{**component, "input": {**part, "structure": needed}}]}
    with RobotManager(loads(json.dumps({**whole, "functions": {"count": counts}}))) as robot:
        connection = robot.request("count")
        connection.send({"x": 1.0, "y": 2.0})
        assert connection.get(patience()) == 2
        with pytest.raises(MessageError, match="x"):
            connection.send({"y": 2.0})


@pytest.mark.parametrize(
    ("address", "reason", "part"),
    [
        ("no_such_module_here:x", FailureReason.NOT_FOUND, "no module 'no_such_module_here'"),
        (f"{HERE}:chang", FailureReason.NOT_FOUND, "did you mean 'change'"),
        (
            f"{HERE}:NOT_CALLABLE",
            FailureReason.BAD_ENDPOINT,
            "is of type int: expected a function or",
        ),
        ("nothing", FailureReason.BAD_ENDPOINT, "module:attribute"),
        ("eye.py:Eye", FailureReason.BAD_ENDPOINT, "as `import` does, not as a file: 'eye'"),
        ("./eye.py:Eye", FailureReason.BAD_ENDPOINT, "as `import` does, not as a file: 'eye'"),
        (".eye:Eye", FailureReason.BAD_ENDPOINT, "as `import` does, not as a file: 'eye'"),
        (f"{HERE}:Eye.__iter__", FailureReason.BAD_ENDPOINT, f"is a method, .* write '{HERE}:Eye'"),
    ],
)
def test_a_bad_address_is_one_clear_error(address: str, reason: FailureReason, part: str) -> None:
    with pytest.raises(BridgeError, match=part) as caught:
        describe(address, Role.OUTPUT)
    assert caught.value.reason is reason


def prepared() -> Iterator[Inner]:
    return source()


class Eye:
    def __iter__(self) -> Iterator[Inner]:
        return source()


@pytest.mark.parametrize(
    ("name", "role", "parameters", "is_quick"),
    [
        ("source", Role.OUTPUT, {}, True),
        ("change", Role.INPUT, {}, True),
        ("change", Role.OUTPUT, {}, True),
        ("change", Role.INPUT, {"factor": 2}, False),  # made by what its hint says
        ("prepared", Role.OUTPUT, {}, False),  # called when it opens
        ("Eye", Role.OUTPUT, {}, False),  # built when it opens
    ],
)
def test_what_runs_code_of_the_component_as_it_opens_is_not_quick(
    name: str,
    role: Role,
    parameters: dict[str, int],
    is_quick: bool,
) -> None:
    bridge = PythonBridge("python", PythonOptions())
    endpoint = Endpoint("python", "c", role, (f"{HERE}:{name}",), parameters=parameters)
    assert not bridge.is_quick(endpoint), "importing it may take long"
    bridge.describe(endpoint)
    assert bridge.is_quick(endpoint) is is_quick
    bridge.close()


def test_a_hint_that_takes_long_to_read_holds_up_no_other_port(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    reading, gate = threading.Event(), threading.Event()

    def read(hint: Any, place: str) -> None:
        if place == "slow":
            reading.set()
            assert gate.wait(patience())

    monkeypatch.setattr("uoarm.local._port.reader", read)
    endpoint = Endpoint("python", "c", Role.INPUT, ("x",))
    slow = Background(lambda: Target("slow", change).port(endpoint).reader)
    assert reading.wait(patience())
    quick = Background(lambda: Target("quick", change).port(endpoint).reader)
    quick.result()
    gate.set()
    slow.result()


def test_a_missing_package_makes_a_component_unavailable(
    tmp_path: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "needs_much.py").write_text("import a_package_that_is_absent\n")
    monkeypatch.syspath_prepend(tmp_path)
    with pytest.raises(
        BridgeError, match="'a_package_that_is_absent', which is not installed"
    ) as caught:
        describe("needs_much:x", Role.OUTPUT)
    assert caught.value.reason is FailureReason.UNAVAILABLE


def test_a_receiver_that_comes_as_another_one_leaves_is_not_forgotten() -> None:
    target = Target("change", change)
    loop, workers = LoopThread("loop"), WorkerPool("source")
    instance = Instance(target, {}, Coroutines(loop, patience()), workers)
    leaving: list[Background[None]] = []

    class Racing(dict[str, Any]):
        """Has a receiver leave as another thread looks who is there."""

        def get(self, *given: Any) -> Any:
            found = super().get(*given)
            leaving.append(Background(lambda: instance.remove_receiver("default", "old")))
            wait(lambda: not leaving[0]._thread.is_alive() or instance._receiving.locked())
            return found

    got: list[Any] = []
    instance.add_receiver("default", "old", got.append)
    instance._receivers = Racing(instance._receivers)
    instance.add_receiver("default", "new", got.append)
    leaving[0].result()
    assert [key for key, _ in instance._receivers["default"]] == ["new"]
    workers.close()
