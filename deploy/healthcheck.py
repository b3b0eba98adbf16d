"""Whether the server of this container answers; the exit status is 0 where it does.

`UOARM_PORT` is its port, 9080 unless it is set. It is asked in plain HTTP first, then with TLS.
"""

from __future__ import annotations

import http.client
import os
import re
import ssl
import sys

_SECONDS = 2.0
_WELL = 200
_LAST_PORT = 65535


def main() -> int:
    """Ask once; returns the exit status."""
    given = os.environ.get("UOARM_PORT", "9080")
    if not re.fullmatch("[0-9]{1,5}", given) or not 0 < (port := int(given)) <= _LAST_PORT:
        sys.stderr.write(f"UOARM_PORT: expected a port, 1 to {_LAST_PORT}, got {given!r}\n")
        return 1
    # On loopback there is no one between: whether it answers is all that is asked.
    unverified = ssl.create_default_context()
    unverified.check_hostname, unverified.verify_mode = False, ssl.CERT_NONE
    problems: list[str] = []
    here = "127.0.0.1"
    for name, connection in (
        ("HTTP", http.client.HTTPConnection(here, port, timeout=_SECONDS)),
        ("TLS", http.client.HTTPSConnection(here, port, timeout=_SECONDS, context=unverified)),
    ):
        try:
            connection.request("GET", "/healthz")
            status = connection.getresponse().status
        except (OSError, http.client.HTTPException) as error:
            problems.append(f"{name}: {error}")
        else:
            if status == _WELL:
                return 0
            problems.append(f"{name}: status {status}")
        finally:
            connection.close()
    sys.stderr.write(f"the server on port {port} does not answer: {', '.join(problems)}\n")
    return 1


if __name__ == "__main__":
    sys.exit(main())
