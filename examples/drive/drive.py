"""Everything at once: the simulated base, `uoarm serve`, and the page; Ctrl-C ends it."""

from __future__ import annotations

import argparse
import os
import re
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterable, Mapping
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


def main() -> int:
    """Start all parts, and end them together."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--port", type=int, default=9080)
    parser.add_argument("--page-port", type=int, default=9081)
    options = parser.parse_args()
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    try:
        pages = ThreadingHTTPServer(
            ("127.0.0.1", options.page_port), partial(Pages, directory=str(HERE))
        )
    except (OSError, OverflowError) as error:
        text = f"cannot listen on 127.0.0.1:{options.page_port}: {error}"
        print(f"{text}; --page-port takes another", file=sys.stderr)
        return 2
    page = f"http://127.0.0.1:{pages.server_port}"
    run = ("setpriv", "--pdeathsig", "TERM", sys.executable)  # ends when this process is killed
    serve = (*run, "-m", "uoarm", "serve", str(HERE / "robot.yaml"), "--origin", page)
    parts: dict[str, subprocess.Popen[bytes]] = {}
    with pages:
        threading.Thread(target=pages.serve_forever, daemon=True).start()
        try:
            parts["base.py"] = subprocess.Popen((*run, str(HERE / "base.py")))
            parts["uoarm serve"] = server = subprocess.Popen(
                (*serve, "--port", str(options.port)), stdout=subprocess.PIPE
            )
            assert server.stdout is not None
            if served := server.stdout.readline().decode():  # "serving ADDRESS ...", or it ends
                print(f"open {page}/?robot={served.split()[1]} to drive; Ctrl-C ends", flush=True)
            return until_one_ends(parts)
        except KeyboardInterrupt:
            return 0
        finally:
            for number in (signal.SIGINT, signal.SIGTERM):
                signal.signal(number, signal.SIG_IGN)  # one of them is under way: see it through
            end(parts.values())
            pages.shutdown()


def until_one_ends(parts: Mapping[str, subprocess.Popen[bytes]]) -> int:
    """Wait until a part ends, which none should; return the exit code for that."""
    while True:
        for name, part in parts.items():
            if part.poll() is not None:
                print(f"{name} ended with {part.returncode}, so all ends", file=sys.stderr)
                return 1
        time.sleep(0.2)


def end(parts: Iterable[subprocess.Popen[bytes]]) -> None:
    """End parts together; what does not listen is killed after half a minute."""
    for part in parts:
        part.terminate()
    for part in parts:
        try:
            part.wait(30)
        except subprocess.TimeoutExpired:
            part.kill()
            part.wait()


if __name__ == "__main__":
    try:
        sys.exit(main())
    except OSError as failure:  # what it prints is read no more, as by `head`, or a disk is full
        if not isinstance(failure, BrokenPipeError):
            print(failure.strerror or failure, file=sys.stderr)
        os._exit(1)
