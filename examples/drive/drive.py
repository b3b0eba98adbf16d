"""Everything at once: the simulated base, `uoarm serve`, and the page; Ctrl-C ends it."""

from __future__ import annotations

import argparse
import re
import signal
import subprocess
import sys
from functools import partial
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from importlib.resources import files
from pathlib import Path

HERE = Path(__file__).parent


class Pages(SimpleHTTPRequestHandler):
    """The page, and the files of the JavaScript client."""

    def translate_path(self, path: str) -> str:
        """Return the file of an address."""
        name = path.partition("?")[0].lstrip("/")
        if re.fullmatch(r"uoarm[a-z-]*\.js", name):
            return str(files("uoarm.server") / "static" / name)
        return super().translate_path(path)

    def log_message(self, *_: object) -> None:
        """Say nothing of what works."""


def main() -> None:
    """Start all parts, and end them together."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--robot-port", type=int, default=9080)
    parser.add_argument("--page-port", type=int, default=9081)
    options = parser.parse_args()
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    pages = ThreadingHTTPServer(
        ("127.0.0.1", options.page_port), partial(Pages, directory=str(HERE))
    )
    page = f"http://127.0.0.1:{pages.server_port}"
    serve = [sys.executable, "-m", "uoarm", "serve", str(HERE / "robot.yaml"), "--origin", page]
    parts = [
        subprocess.Popen([sys.executable, str(HERE / "base.py")]),
        subprocess.Popen([*serve, "--port", str(options.robot_port)]),
    ]
    print(f"open {page}/?robot=ws://127.0.0.1:{options.robot_port}/", flush=True)
    try:
        with pages:
            pages.serve_forever()
    except KeyboardInterrupt:
        pass
    finally:
        for part in parts:
            part.terminate()
        for part in parts:
            part.wait(30)


if __name__ == "__main__":
    main()
