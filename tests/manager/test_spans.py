"""Spans of OpenTelemetry: real ones of its SDK, and nothing where it is not used."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Iterator
from types import ModuleType
from typing import Any

import pytest

from uoarm import ResolutionError, RobotManager
from uoarm._spans import current, span
from uoarm.config import loads
from uoarm.testing import MemoryBridge, wait

NUMBER: Any = {"type": "integer"}
ROBOT = """
version: 1
bridges: {memory: {}}
functions:
  camera:
    components:
      - {name: best, bridge: memory, priority: 2, output: {endpoint: [best]}}
      - {name: next, bridge: memory, priority: 1, output: {endpoint: [next]}}
  nothing:
    components:
      - {name: absent, bridge: memory, output: {endpoint: [absent]}}
"""


@pytest.fixture
def spans(monkeypatch: pytest.MonkeyPatch) -> Iterator[Any]:
    """What the SDK was given to export; the tracer is handed in, as a process has only one."""
    sdk = pytest.importorskip("opentelemetry.sdk.trace")
    export = pytest.importorskip("opentelemetry.sdk.trace.export")
    memory = pytest.importorskip("opentelemetry.sdk.trace.export.in_memory_span_exporter")
    exporter = memory.InMemorySpanExporter()
    provider = sdk.TracerProvider()
    provider.add_span_processor(export.SimpleSpanProcessor(exporter))
    trace = sys.modules["opentelemetry.trace"]
    monkeypatch.setattr(trace, "get_tracer", provider.get_tracer)
    yield exporter
    provider.shutdown()


def test_a_request_and_a_takeover_are_spans_of_one_trace(spans: Any) -> None:
    bridge = MemoryBridge("memory", {})
    bridge.emitter("best", NUMBER)
    bridge.emitter("next", NUMBER)
    with RobotManager(loads(ROBOT), bridges={"memory": bridge}) as robot:
        robot.request("camera")
        bridge.die("best")
        wait(
            lambda: (
                "uoarm.takeover"
                in [finished_span.name for finished_span in spans.get_finished_spans()]
            )
        )
    found = {finished_span.name: finished_span for finished_span in spans.get_finished_spans()}
    request, takeover = found["uoarm.request"], found["uoarm.takeover"]
    assert dict(request.attributes) == {"uoarm.function": "camera", "uoarm.connection": "c1"}
    assert takeover.attributes["uoarm.before"] == "best"
    assert takeover.attributes["uoarm.after"] == "next"
    assert "component 'best' was lost" in takeover.attributes["uoarm.cause"]
    for name in ("uoarm.resolve", "uoarm.open", "uoarm.takeover"):
        assert found[name].parent.span_id == request.context.span_id
        assert found[name].start_time <= found[name].end_time


def test_a_request_that_fails_is_a_span_with_its_exception(spans: Any) -> None:
    bridge = MemoryBridge("memory", {})
    with (
        RobotManager(loads(ROBOT), bridges={"memory": bridge}) as robot,
        pytest.raises(ResolutionError),
    ):
        robot.request("nothing")
    found = {finished_span.name: finished_span for finished_span in spans.get_finished_spans()}
    assert not found["uoarm.request"].status.is_ok
    assert found["uoarm.resolve"].events[0].name == "exception"


def test_a_block_runs_while_another_thread_imports_opentelemetry(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    for name in ("opentelemetry.context", "opentelemetry.trace"):
        monkeypatch.setitem(sys.modules, name, ModuleType(name))
    assert current() is None
    with span("request"):
        pass


def test_nothing_is_imported_where_opentelemetry_is_not_used() -> None:
    code = (
        "import sys, uoarm\n"
        "from uoarm._spans import current, span\n"
        "with span('request', function='x'): assert current() is None\n"
        "assert not any(name.startswith('opentelemetry') for name in sys.modules)\n"
    )
    subprocess.run([sys.executable, "-c", code], check=True, timeout=600)
