"""Spans and figures of OpenTelemetry: in an application, and sent by a server to a collector."""

from __future__ import annotations

import asyncio
import json
import os
import re
import signal
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any
from urllib.request import urlopen

import click
import pytest
from opentelemetry.sdk.trace import TracerProvider
from tests.processes import run_python
from tests.server.robot import CONFIGURATION

from uoarm.cli._serve import exporting
from uoarm.client import connect
from uoarm.testing import patience, wait

ROOT = Path(__file__).parents[2]
APPLICATION = """
import json, sys
from opentelemetry import metrics
from opentelemetry.sdk.metrics import MeterProvider
from opentelemetry.sdk.metrics.export import InMemoryMetricReader
from uoarm import RobotManager
from uoarm.config import loads
from uoarm.testing import MemoryBridge, wait

reader = InMemoryMetricReader()
metrics.set_meter_provider(MeterProvider([reader]))
text = '''
version: 1
bridges: {memory: {}}
functions: {camera: {components: [{name: eye, bridge: memory, output: {endpoint: [eye]}}]}}
'''

def points():
    data = reader.get_metrics_data()
    if data is None:
        return {}
    return {
        metric.name: [[point.value, dict(point.attributes)] for point in metric.data.data_points]
        for of_resource in data.resource_metrics
        for scope in of_resource.scope_metrics
        for metric in scope.metrics
    }

def robot():
    memory = MemoryBridge("memory")
    return memory, RobotManager(loads(text), bridges={"memory": memory})

memory, first = robot()
eye = memory.emitter("eye", {"type": "integer"})
connection = first.request("camera")
eye.emit(1)
wait(lambda: points().get("uoarm_route_delivered", [[0]])[0][0] == 1)
alone = points()
_, second = robot()
second.close()
after = points()
first.close()
wait(lambda: not points())
print(json.dumps([alone, after]))
"""


def test_an_application_that_collects_metrics_gets_figures_of_its_managers() -> None:
    ran = run_python("-W", "error", "-c", APPLICATION)
    assert ran.returncode == 0, ran.stderr
    alone, after = json.loads(ran.stdout)
    ends = {"producer": "eye.default", "consumer": "c1"}
    assert alone["uoarm_route_received"] == [[1, ends]]
    assert [1, {"state": "running"}] in alone["uoarm_connections"]
    assert alone["uoarm_component_health"] == [
        [1, {"component": "eye", "function": "camera", "health": "ok"}]
    ]
    assert after["uoarm_route_received"] == [[1, ends]]
    assert "created already" not in ran.stderr


class Collector:
    """A receiver of OTLP over HTTP, as a collector of OpenTelemetry is."""

    def __init__(self) -> None:
        from opentelemetry.proto.collector.metrics.v1.metrics_service_pb2 import (
            ExportMetricsServiceRequest,
        )
        from opentelemetry.proto.collector.trace.v1.trace_service_pb2 import (
            ExportTraceServiceRequest,
        )

        requests: dict[str, Any] = {
            "/v1/traces": ExportTraceServiceRequest,
            "/v1/metrics": ExportMetricsServiceRequest,
        }
        self.requests: list[Any] = []
        collector = self

        class Handler(BaseHTTPRequestHandler):
            def do_POST(self) -> None:
                octets = self.rfile.read(int(self.headers["Content-Length"]))
                if self.headers.get("Content-Encoding") is None:
                    collector.requests.append(requests[self.path].FromString(octets))
                self.send_response(200)
                self.send_header("Content-Length", "0")
                self.end_headers()

            def log_message(self, *_: object) -> None:
                pass

        self._server = ThreadingHTTPServer(("127.0.0.1", 0), Handler)
        self._thread = threading.Thread(target=self._server.serve_forever)
        self._thread.start()
        self.url = f"http://127.0.0.1:{self._server.server_address[1]}"

    def spans(self) -> dict[str, Any]:
        return {
            span.name: span
            for request in list(self.requests)
            for resource in getattr(request, "resource_spans", ())
            for scope in resource.scope_spans
            for span in scope.spans
        }

    def metrics(self) -> set[str]:
        return {
            metric.name
            for request in list(self.requests)
            for resource in getattr(request, "resource_metrics", ())
            for scope in resource.scope_metrics
            for metric in scope.metrics
        }

    def services(self) -> set[str]:
        return {
            attribute.value.string_value
            for request in list(self.requests)
            for kind in ("resource_spans", "resource_metrics")
            for resource in getattr(request, kind, ())
            for attribute in resource.resource.attributes
            if attribute.key == "service.name"
        }

    def close(self) -> None:
        self._server.shutdown()
        self._server.server_close()
        self._thread.join()


@pytest.fixture
def collector() -> Iterator[Collector]:
    collector = Collector()
    yield collector
    collector.close()


def started(folder: Path, *words: str, **environment: str) -> tuple[subprocess.Popen[str], str]:
    file = folder / "robot.yaml"
    file.write_text(CONFIGURATION, encoding="utf-8")
    process = subprocess.Popen(
        [sys.executable, "-m", "uoarm", "serve", str(file), "--port", "0", *words],
        stdout=subprocess.PIPE,
        text=True,
        env={
            **os.environ,
            "PYTHONPATH": str(ROOT),
            "XDG_STATE_HOME": str(folder / "state"),
            **environment,
        },
    )
    assert process.stdout is not None
    found = re.search(r"ws://127\.0\.0\.1:\d+/", process.stdout.readline())
    assert found is not None
    return process, found[0]


def use(url: str, until: Callable[[], object] = lambda: True) -> None:
    """Open a function as a client, and end it once something is true."""

    async def request() -> None:
        async with connect(url) as robot:
            stream = await robot.request("numbers")
            await asyncio.to_thread(wait, until)
            await stream.kill()

    asyncio.run(request())


def test_a_server_sends_spans_and_figures_to_a_collector(
    tmp_path: Path, collector: Collector
) -> None:
    soon = {"OTEL_METRIC_EXPORT_INTERVAL": "200", "OTEL_BSP_SCHEDULE_DELAY": "100"}
    process, url = started(tmp_path, "--otlp", f"{collector.url}/", **soon)
    try:
        use(url, lambda: "uoarm_route_received" in collector.metrics())
        wait(lambda: {"uoarm.request", "uoarm.kill"} <= set(collector.spans()))
        spans = collector.spans()
        assert spans["uoarm.open"].parent_span_id == spans["uoarm.request"].span_id
        assert spans["uoarm.kill"].trace_id == spans["uoarm.request"].trace_id
        assert collector.services() == {"uoarm"}
        with urlopen(f"{url.replace('ws:', 'http:')}metrics", timeout=patience()) as answer:
            names = re.findall(r"^# TYPE (\w+) ", answer.read().decode(), re.MULTILINE)
        # Those of Prometheus, which ends counters with _total and has the server's own, too.
        assert collector.metrics() <= {name.removesuffix("_total") for name in names}
        process.send_signal(signal.SIGTERM)
        assert process.wait(patience()) == 0
    finally:
        process.kill()
        process.communicate()


def test_a_collector_that_hangs_holds_up_no_end(monkeypatch: pytest.MonkeyPatch) -> None:
    ended = threading.Event()
    gate = threading.Event()
    end = TracerProvider.shutdown

    def shutdown(provider: TracerProvider) -> None:
        gate.wait(patience())
        end(provider)
        ended.set()

    monkeypatch.setattr(TracerProvider, "shutdown", shutdown)
    monkeypatch.setattr("opentelemetry.trace.set_tracer_provider", lambda _: None)
    monkeypatch.setattr("opentelemetry.metrics.set_meter_provider", lambda _: None)
    monkeypatch.setattr("uoarm.cli._serve._LAST_SECONDS", 0.0)
    monkeypatch.setenv("OTEL_EXPORTER_OTLP_TIMEOUT", "1")
    with exporting("http://127.0.0.1:1"):
        pass
    try:
        assert not ended.is_set()
    finally:
        gate.set()
        wait(lambda: all(thread.name != "uoarm-otlp-end" for thread in threading.enumerate()))


@pytest.mark.parametrize(
    "url", ["127.0.0.1:4318", "ftp://x", "http://", "http://x:port", "http://x:0"]
)
def test_what_is_no_collector_is_refused(url: str) -> None:
    with pytest.raises(click.BadParameter, match="expected http://HOST:PORT or "), exporting(url):
        pytest.fail("it is none")


def test_a_collector_that_is_gone_holds_up_nothing(tmp_path: Path) -> None:
    gone = Collector()
    gone.close()
    process, url = started(tmp_path, "--otlp", gone.url, OTEL_EXPORTER_OTLP_TIMEOUT="1")
    try:
        use(url)
        process.send_signal(signal.SIGTERM)
        assert process.wait(patience()) == 0
    finally:
        process.kill()
        process.communicate()


def test_without_a_collector_nothing_of_it_is_imported() -> None:
    code = (
        "import sys\n"
        "from uoarm.cli._serve import exporting\n"
        "from uoarm import RobotManager\n"
        "from uoarm.config import loads\n"
        "with exporting(None), RobotManager(loads('version: 1\\nbridges: {}\\nfunctions: {}')):\n"
        "    assert not any(name.startswith('opentelemetry') for name in sys.modules)\n"
    )
    subprocess.run([sys.executable, "-c", code], check=True, timeout=patience())
