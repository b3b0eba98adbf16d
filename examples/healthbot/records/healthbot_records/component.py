"""The function `patientRecord`: keeps a measurement on disk, and sends it until it is stored."""

from __future__ import annotations

import logging
import threading
from pathlib import Path
from typing import Any, TypedDict

import httpx

from healthbot_records.observation import Measurement, observation
from healthbot_records.spool import Spool

__all__ = ["PatientRecord", "Receipt"]

_log = logging.getLogger("healthbot")
_SEND_SECONDS = 2.0
_FIRST_PAUSE, _LONGEST_PAUSE = 0.2, 10.0
_LATER = {408, 429}  # too slow, too many: 4xx, yet no fault of the measurement


class Receipt(TypedDict):
    """What became of a measurement: `waiting` counts all that are not stored yet."""

    id: str
    stored: bool
    waiting: int


class PatientRecord:
    """Stores measurements in a FHIR service, through a durable queue.

    Args:
        url: of the service, `http://127.0.0.1:8088/fhir`.
        spool: file of the queue; the measurements in it are sent first after a restart.
    """

    def __init__(self, url: str, spool: str) -> None:
        self._client = httpx.Client(base_url=url, timeout=_SEND_SECONDS)
        self._spool = Spool(Path(spool))
        self._sending = threading.Lock()
        self._news = threading.Event()
        self._stopped = threading.Event()
        self._thread = threading.Thread(target=self._work, name="patient-record", daemon=True)
        self._news.set()
        self._thread.start()

    def __call__(self, request: Measurement) -> Receipt:
        """Keep one measurement; stored at once where the service is up, soon otherwise.

        Raises:
            ValueError: the measurement says too little, or its value is no number, or the
                service refused it for good.
        """
        resource = observation(request)
        self._spool.put(resource)
        self._send_all()
        refusal = self._spool.refusal(resource["id"])
        if refusal is not None:
            raise ValueError(f"the record service refused it: {refusal}")
        waits = self._spool.holds(resource["id"])
        if waits:
            self._news.set()
        return {"id": resource["id"], "stored": not waits, "waiting": len(self._spool)}

    def close(self) -> None:
        """Stop sending; what waits is kept for the next time."""
        self._stopped.set()
        self._news.set()
        self._thread.join(2 * _SEND_SECONDS)
        with self._sending:
            self._client.close()
            self._spool.close()

    def _work(self) -> None:
        pause = _FIRST_PAUSE
        while not self._stopped.is_set():
            self._news.wait()
            self._news.clear()
            while not self._stopped.is_set() and not self._send_all():
                self._stopped.wait(pause)
                pause = min(2 * pause, _LONGEST_PAUSE)
            pause = _FIRST_PAUSE

    def _send_all(self) -> bool:
        """Send what waits, oldest first; return False when the service did not take it."""
        with self._sending:
            while not self._stopped.is_set() and (resource := self._spool.oldest()) is not None:
                if not self._send(resource):
                    return False
        return True

    def _send(self, resource: dict[str, Any]) -> bool:
        try:
            answer = self._client.put(f"/Observation/{resource['id']}", json=resource)
        except httpx.HTTPError as error:
            _log.info("the record service is not there: %s", error)
            return False
        if answer.is_server_error or answer.status_code in _LATER:
            _log.warning("the record service answered %s", answer.status_code)
            return False
        if answer.is_success:
            self._spool.remove(resource["id"])
        else:
            _log.error("the record service refused %s: %s", resource["id"], answer.text)
            self._spool.refuse(resource["id"], answer.text)
        return True
