"""Records of logging as lines: for people, for programs, and from a host to its manager.

Whatever writes them leaves out what lets a client in: tokens and passwords.
"""

from __future__ import annotations

import json
import logging
import re
import sys
from datetime import datetime, timezone

from uoarm._encodable import encodable, printable

HOST_LINE = 8192
"""The most octets of a line that a host writes and its manager reads in one piece."""

_SHORTENED = 600
_LEVELS = {
    name: getattr(logging, name) for name in ("DEBUG", "INFO", "WARNING", "ERROR", "CRITICAL")
}
# As headers of HTTP, offers of WebSocket clients, and URLs have them; libraries log these at debug.
_SECRET = re.compile(
    r"(?i:\bbearer\s+|\b(?:proxy-)?authorization[\"']?\s*[:=]\s*|\b(?:set-)?cookie[\"']?\s*:\s*)"
    r"[^\r\n]+|(?<=\buoarm\.token\.)[^\s,\"']+|(?<=://)[^\s/@]+(?=@)"
    r"|(?<=[?&]token=)[^\s&#\"']+"
)
_HIDDEN = "***"


def _text_of(record: logging.LogRecord) -> str:
    """Return the message of a record, and below it the traceback: encodable, without secrets."""
    text = logging.Formatter("%(message)s").format(record)
    return encodable(_SECRET.sub(_HIDDEN, text))


def _time_of(record: logging.LogRecord) -> str:
    time = datetime.fromtimestamp(record.created, timezone.utc)
    return time.isoformat(timespec="milliseconds").replace("+00:00", "Z")


class TextFormatter(logging.Formatter):
    """Time, level, logger and text. Further lines are indented: no text looks like a record."""

    def format(self, record: logging.LogRecord) -> str:
        indented = printable(_text_of(record)).replace("\n", "\n  ")
        return f"{_time_of(record)} {record.levelname} {record.name}: {indented}"


class JsonFormatter(logging.Formatter):
    """One object of JSON in one line: `time`, `level`, `logger`, `text`."""

    def format(self, record: logging.LogRecord) -> str:
        fields = {
            "time": _time_of(record),
            "level": record.levelname,
            "logger": record.name,
            "text": _text_of(record),
        }
        return json.dumps(fields)


class StderrHandler(logging.Handler):
    """Writes to what `sys.stderr` is when a record comes."""

    def emit(self, record: logging.LogRecord) -> None:
        """Write the lines of a record; what cannot be written is lost."""
        try:
            sys.stderr.write(f"{self.format(record)}\n")
            sys.stderr.flush()
        except Exception:  # noqa: BLE001 - the code that logs must not pay for it
            self.handleError(record)


class HostFormatter(logging.Formatter):
    """A record as its level, and logger and text as JSON, in one line that a manager can read."""

    def format(self, record: logging.LogRecord) -> str:
        text = _text_of(record)
        line = self._line(record, text)
        if len(line.encode(errors="replace")) < HOST_LINE:
            return line
        return self._line(record, f"{text[:_SHORTENED]} ... {text[-_SHORTENED:]}")

    def _line(self, record: logging.LogRecord, text: str) -> str:
        return f"{record.levelname} {json.dumps([record.name, text])}"


def read_host_line(line: str) -> tuple[int | None, str]:
    """Return level and text of a line that a host printed; without a level what is no record."""
    level, _, rest = line.partition(" ")
    if level not in _LEVELS:
        return None, line
    try:
        name, text = json.loads(rest)
    except (ValueError, TypeError):
        return _LEVELS[level], rest
    return _LEVELS[level], f"{name}: {text}"
