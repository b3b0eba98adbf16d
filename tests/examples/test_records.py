"""Patient records: nothing is stored twice, and nothing is lost while the service is down."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import threading
from collections.abc import Iterator
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any

import pytest

from uoarm.testing import patience

RECORDS = Path(__file__).parents[2] / "examples" / "healthbot" / "records"
sys.path.insert(0, str(RECORDS))

import httpx  # noqa: E402
from healthbot_records.component import PatientRecord  # noqa: E402
from healthbot_records.observation import Measurement, identity, observation  # noqa: E402
from healthbot_records.spool import Spool  # noqa: E402

from uoarm.local import PythonBridge, PythonOptions  # noqa: E402
from uoarm.model import Endpoint, Role  # noqa: E402
from uoarm.testing import wait  # noqa: E402

PULSE: Measurement = {
    "patient": "p1", "kind": "pulse", "time": "2026-11-21T09:00:00Z", "value": 71
}  # fmt: skip
PRESSURE: Measurement = {
    "patient": "p1",
    "kind": "pressure",
    "time": "2026-11-21T09:01:00+13:00",
    "systolic": 121,
    "diastolic": 78,
}


class Service:
    """The web service in a process of its own, on a port that it keeps."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._process: subprocess.Popen[str] | None = None
        self.url = ""
        self.start(0)

    def start(self, port: int | None = None) -> None:
        wanted = self.url.rsplit(":", 1)[-1].removesuffix("/fhir") if port is None else str(port)
        command = [sys.executable, "-m", "healthbot_records", "--port", wanted]
        self._process = subprocess.Popen(
            [*command, "--database", str(self._folder / "records.db")],
            env={**os.environ, "PYTHONPATH": str(RECORDS)},
            stdout=subprocess.PIPE,
            text=True,
        )
        assert self._process.stdout is not None
        self.url = self._process.stdout.readline().split()[-1]

    def stop(self, how: signal.Signals = signal.SIGTERM) -> None:
        if self._process is not None:
            self._process.send_signal(how)
            self._process.communicate(timeout=patience())
            self._process = None

    def stored(self) -> list[dict[str, Any]]:
        bundle = httpx.get(
            f"{self.url}/Observation", params={"patient": "p1"}, timeout=patience()
        ).json()
        return [entry["resource"] for entry in bundle["entry"]]


@pytest.fixture(autouse=True)
def _a_service_that_is_there_has_time(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("healthbot_records.component._SEND_SECONDS", patience())


@pytest.fixture
def service(tmp_path: Path) -> Iterator[Service]:
    made = Service(tmp_path)
    yield made
    made.stop()


@pytest.fixture
def record(service: Service, tmp_path: Path) -> Iterator[PatientRecord]:
    made = PatientRecord(service.url, str(tmp_path / "spool.db"))
    yield made
    made.close()


def test_a_measurement_becomes_an_observation_with_its_codes() -> None:
    heart_rate, pressure = observation(PULSE), observation(PRESSURE)
    assert heart_rate["code"]["coding"][0]["code"] == "8867-4"
    assert heart_rate["valueQuantity"]["value"] == 71
    parts = {item["code"]["coding"][0]["code"]: item for item in pressure["component"]}
    assert parts["8480-6"]["valueQuantity"]["value"] == 121
    assert parts["8462-4"]["valueQuantity"]["code"] == "mm[Hg]"


@pytest.mark.parametrize(
    ("change", "expected"),
    [({"time": "2026-11-21T09:00:00"}, "no offset"), ({"value": None}, "value")],
)
def test_a_measurement_that_says_too_little_is_refused(change: Any, expected: str) -> None:
    with pytest.raises(ValueError, match=expected):
        observation({**PULSE, **change})


def test_what_is_sent_twice_is_stored_once(service: Service, record: PatientRecord) -> None:
    first, second = record(PULSE), record(PULSE)
    assert first == second == {"id": identity(PULSE), "stored": True, "waiting": 0}
    assert [item["id"] for item in service.stored()] == [identity(PULSE)]


def test_two_visits_in_the_same_moment_stay_two(service: Service, record: PatientRecord) -> None:
    for visit in ("one", "two"):
        record({**PULSE, "visit": visit})
    found = {item["encounter"]["identifier"]["value"] for item in service.stored()}
    assert found == {"one", "two"}


def test_nothing_is_lost_while_the_service_is_down(
    service: Service, record: PatientRecord, tmp_path: Path
) -> None:
    record(PULSE)
    service.stop(signal.SIGKILL)
    receipt = record(PRESSURE)
    assert receipt == {"id": identity(PRESSURE), "stored": False, "waiting": 1}
    record.close()
    left = Spool(tmp_path / "spool.db")
    assert len(left) == 1
    left.close()
    service.start()
    again = PatientRecord(service.url, str(tmp_path / "spool.db"))
    try:
        wait(lambda: len(service.stored()) == 2, "what waited never arrived")
        assert {item["id"] for item in service.stored()} == {identity(PULSE), identity(PRESSURE)}
    finally:
        again.close()


@pytest.mark.parametrize(
    ("body", "expected"),
    [
        (b"{", "not JSON"),
        (b"[" * 60_000, "not JSON"),
        (b'{"resourceType": "Observation", "valueQuantity": NaN}', "not JSON"),
        (b'{"resourceType": "Observation", "status": "\\ud800"}', "not JSON"),
        (b'{"resourceType": "Patient"}', "type Observation"),
        (b'{"resourceType": "Observation", "id": "other"}', "not that of the address"),
        (b'{"resourceType": "Observation", "id": "x"}', "must be there"),
        (b" " * 70_000, "larger than"),
    ],
)
def test_the_service_says_what_is_wrong_with_a_resource(
    service: Service, body: bytes, expected: str
) -> None:
    answer = httpx.put(f"{service.url}/Observation/x", content=body, timeout=patience())
    assert answer.status_code == 400
    outcome = answer.json()
    assert outcome["resourceType"] == "OperationOutcome"
    assert expected in outcome["issue"][0]["diagnostics"]


def test_what_the_service_refuses_for_good_holds_up_nothing(
    service: Service, record: PatientRecord
) -> None:
    with pytest.raises(ValueError, match=r"refused it: .*larger than"):
        record({**PULSE, "patient": "p" * 70_000})
    assert record(PULSE)["stored"]


@pytest.fixture
def answering() -> Iterator[tuple[str, list[int]]]:
    """A service at an address; it answers the last of these codes, and takes that one off."""
    codes: list[int] = []

    class Handler(BaseHTTPRequestHandler):
        def do_PUT(self) -> None:
            self.rfile.read(int(self.headers["Content-Length"]))
            self.send_response(codes.pop())
            self.send_header("Content-Length", "0")
            self.end_headers()

        def log_message(self, *_: object) -> None:
            pass

    with ThreadingHTTPServer(("127.0.0.1", 0), Handler) as server:
        thread = threading.Thread(target=server.serve_forever)
        thread.start()
        yield f"http://127.0.0.1:{server.server_port}", codes
        server.shutdown()
        thread.join()


def test_what_was_refused_once_can_be_stored_later(
    answering: tuple[str, list[int]], tmp_path: Path
) -> None:
    url, codes = answering
    codes += [201, 403]
    record = PatientRecord(url, str(tmp_path / "spool.db"))
    try:
        with pytest.raises(ValueError, match="refused it"):
            record(PULSE)
        assert record(PULSE) == {"id": identity(PULSE), "stored": True, "waiting": 0}
    finally:
        record.close()


@pytest.mark.parametrize("code", [408, 429, 503])
def test_what_the_service_puts_off_is_sent_again(
    answering: tuple[str, list[int]], tmp_path: Path, code: int
) -> None:
    url, codes = answering
    codes += [201, 201, code]
    record = PatientRecord(url, str(tmp_path / "spool.db"))
    try:
        record(PULSE)
        assert record(PULSE)["stored"]
    finally:
        record.close()


def test_what_cannot_be_sent_holds_up_nothing(record: PatientRecord) -> None:
    with pytest.raises(ValueError, match="JSON compliant"):
        record({**PULSE, "value": float("nan")})
    assert record(PULSE) == {"id": identity(PULSE), "stored": True, "waiting": 0}


def test_an_observation_can_be_read_and_searched(service: Service, record: PatientRecord) -> None:
    record(PULSE)
    record(PRESSURE)
    found = httpx.get(f"{service.url}/Observation/{identity(PULSE)}", timeout=patience()).json()
    assert found == observation(PULSE)
    bundle = httpx.get(
        f"{service.url}/Observation", params={"code": "85354-9"}, timeout=patience()
    ).json()
    assert bundle["total"] == 1
    assert httpx.get(f"{service.url}/Observation/none", timeout=patience()).status_code == 404


def test_what_waits_is_sent_without_another_call(service: Service, tmp_path: Path) -> None:
    """Through the bridge, as the robot calls it: the queue works on between calls."""
    parameters = {"url": service.url, "spool": str(tmp_path / "bridged.db")}
    address = ("healthbot_records.component:PatientRecord",)
    endpoint = Endpoint("records", "record", Role.SERVICE, address, parameters=parameters)
    bridge = PythonBridge("records", PythonOptions.of({"path": [str(RECORDS)]}))
    try:
        service.stop(signal.SIGKILL)
        report = bridge.call(endpoint, dict(PULSE), timeout=patience())
        assert report == {"id": identity(PULSE), "stored": False, "waiting": 1}
        service.start()
        wait(service.stored, "the measurement never arrived")
    finally:
        bridge.close()
