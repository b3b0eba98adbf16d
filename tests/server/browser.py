"""A real Chromium without a window, driven over its own debugging protocol."""

from __future__ import annotations

import base64
import itertools
import json
import os
import shutil
import subprocess
import time
from contextlib import ExitStack
from pathlib import Path
from tempfile import mkdtemp
from typing import Any

from typing_extensions import Self
from websockets.sync.client import ClientConnection, connect

from uoarm.testing import patience, wait

SECONDS = patience()
NAMES = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable")
OPTIONS = (
    "--headless",
    "--no-sandbox",
    "--disable-gpu",
    "--disable-quic",
    "--disable-dev-shm-usage",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
    "--disable-features=BackForwardCache",  # which would keep each page that a test has left
    "--remote-debugging-port=0",
)
KEYS = {
    "Enter": (13, "\r"),
    "Escape": (27, ""),
    "Tab": (9, ""),
    "Backspace": (8, ""),
    " ": (32, " "),
    "[": (219, "["),
    "]": (221, "]"),
    "ArrowLeft": (37, ""),
    "ArrowUp": (38, ""),
    "ArrowRight": (39, ""),
    "ArrowDown": (40, ""),
    "Home": (36, ""),
}


def find_chromium() -> str | None:
    return next((found for name in NAMES if (found := shutil.which(name))), None)


def _is_removed(folder: str) -> bool:
    shutil.rmtree(folder, ignore_errors=True)
    return not Path(folder).exists()


class Browser:
    """One Chromium with an empty profile, and one page in it."""

    def __init__(self, program: str) -> None:
        self._stack = ExitStack()
        self._ids = itertools.count(1)
        self.requests: list[str] = []
        self.complaints: list[str] = []
        profile = mkdtemp()
        # Its other processes end a little after the first one, and write there until then.
        self._stack.callback(wait, lambda: _is_removed(profile), "chromium goes on writing")
        self._process = subprocess.Popen(
            [program, *OPTIONS, f"--user-data-dir={profile}", "about:blank"],
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            env={**os.environ, "TMPDIR": profile},
        )
        self._stack.callback(self._stop)
        try:
            self._socket = self._connect(Path(profile) / "DevToolsActivePort")
            target = self._attach()
            self._session = target
            for domain in ("Page", "Runtime", "Network", "Log"):
                self.command(f"{domain}.enable")
        except BaseException:
            self._stack.close()
            raise

    def command(self, method: str, **parameters: Any) -> dict[str, Any]:
        """Send one command and return its result."""
        number = next(self._ids)
        message = {"id": number, "method": method, "params": parameters}
        if session := getattr(self, "_session", ""):
            message["sessionId"] = session
        self._socket.send(json.dumps(message))
        while (report := json.loads(self._socket.recv(timeout=SECONDS))).get("id") != number:
            self._note(report)
        assert "error" not in report, f"{method}: {report['error']}"
        result: dict[str, Any] = report["result"]
        return result

    def js(self, expression: str) -> Any:
        """Return the value of an expression in the page."""
        reports = self.command(
            "Runtime.evaluate", expression=expression, returnByValue=True, awaitPromise=True
        )
        assert "exceptionDetails" not in reports, (expression, reports["exceptionDetails"])
        return reports["result"].get("value")

    def until(self, expression: str) -> Any:
        """Wait until an expression is true in the page and return it."""
        deadline = time.monotonic() + SECONDS
        while (value := self.js(f"({expression}) || null")) is None:
            shown = self.js("document.body?.innerText.slice(0, 2000)")
            self._come_back()
            assert time.monotonic() < deadline, f"never: {expression}\n{shown}\n{self.complaints}"
            time.sleep(0.02)
        return value

    def _come_back(self) -> None:
        """Load the page again when Chromium gave it up because an interface came or went.

        Any interface of the machine will do, such as one that another test makes.
        """
        others = [
            complaint for complaint in self.complaints if "ERR_NETWORK_CHANGED" not in complaint
        ]
        if len(others) < len(self.complaints):
            self.complaints[:] = others
            # `Page.reload` returns while the old document still answers: what it is given is lost.
            history = self.command("Page.getNavigationHistory")
            self.go(history["entries"][history["currentIndex"]]["url"])

    def go(self, url: str) -> None:
        self.command("Page.navigate", url="about:blank")
        self.command("Page.navigate", url=url)

    def show(self, width: int, height: int, *, phone: bool = False, dark: bool = False) -> None:
        self.command(
            "Emulation.setDeviceMetricsOverride",
            width=width,
            height=height,
            deviceScaleFactor=1,
            mobile=phone,
        )
        scheme = {"name": "prefers-color-scheme", "value": "dark" if dark else "light"}
        self.command("Emulation.setEmulatedMedia", features=[scheme])

    def click(self, selector: str, text: str = "", *, shift: bool = False) -> None:
        """Press the middle of the first visible element that a selector and a text find.

        What took its place meanwhile gets nothing of that, and it is tried again.
        """
        deadline = time.monotonic() + SECONDS
        while True:
            place = self.until(f"({_AIM})({json.dumps(selector)}, {json.dumps(text)})")
            for kind in ("mousePressed", "mouseReleased"):
                self.command(
                    "Input.dispatchMouseEvent",
                    type=kind,
                    button="left",
                    clickCount=1,
                    modifiers=8 * shift,
                    **place,
                )
            if not self.js("window.missed"):
                return
            assert time.monotonic() < deadline, f"never hit: {selector} {text}"

    def press(self, key: str, *, shift: bool = False, control: bool = False) -> None:
        code, text = KEYS.get(key, (ord(key[0].upper()), key))
        modifiers = 8 * shift + 2 * control
        given = {"key": key, "windowsVirtualKeyCode": code, "modifiers": modifiers}
        written = "" if control else text
        self.command("Input.dispatchKeyEvent", type="keyDown", text=written, **given)
        self.command("Input.dispatchKeyEvent", type="keyUp", **given)

    def write(self, text: str) -> None:
        """Put text where the keyboard is."""
        self.command("Input.insertText", text=text)

    def picture(self, path: Path) -> None:
        data = self.command("Page.captureScreenshot", format="png")["data"]
        path.write_bytes(base64.b64decode(data))

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._stack.close()

    def _connect(self, file: Path) -> ClientConnection:
        def started() -> bool:
            assert self._process.poll() is None, "chromium ended at once"
            return file.exists() and file.read_text().count("\n") > 0

        wait(started, "chromium does not start")
        port, path = file.read_text().split("\n")[:2]
        url = f"ws://127.0.0.1:{port}{path}"
        return self._stack.enter_context(connect(url, max_size=None, compression=None))

    def _attach(self) -> str:
        target = self.command("Target.createTarget", url="about:blank")["targetId"]
        session: str = self.command("Target.attachToTarget", targetId=target, flatten=True)[
            "sessionId"
        ]
        return session

    def _note(self, event: dict[str, Any]) -> None:
        parameters = event.get("params", {})
        if event.get("method") == "Network.requestWillBeSent":
            self.requests.append(parameters["request"]["url"])
        elif event.get("method") == "Network.webSocketCreated":
            self.requests.append(parameters["url"])
        elif event.get("method") == "Runtime.exceptionThrown":
            details = parameters["exceptionDetails"]
            self.complaints.append(details.get("exception", {}).get("description", str(details)))
        elif event.get("method") == "Log.entryAdded" and parameters["entry"]["level"] == "error":
            self.complaints.append(
                f"{parameters['entry']['text']} {parameters['entry'].get('url')}"
            )

    def _stop(self) -> None:
        self._process.terminate()
        try:
            self._process.wait(SECONDS)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()


_AIM = """(selector, text) => {
  for (const one of document.querySelectorAll(selector)) {
    if (!one.textContent.includes(text)) continue;
    one.scrollIntoView({ block: "nearest" });
    const { left, top, width, height } = one.getBoundingClientRect();
    if (!(width > 0 && height > 0)) continue;
    window.missed = true;
    window.aim?.abort(); // of a press that was no click
    const over = window.aim = new AbortController();
    const take = (event) => {
      const hit = event.composedPath().includes(one);
      if (!hit) event.stopImmediatePropagation();
      if (!hit) event.preventDefault();
      if (event.type === "click") window.missed = !hit;
      if (event.type === "click") over.abort();
    };
    for (const type of ["pointerdown", "mousedown", "pointerup", "mouseup", "click"]) {
      window.addEventListener(type, take, { capture: true, signal: over.signal });
    }
    return { x: left + width / 2, y: top + height / 2 };
  }
  return null;
}"""


def text(selector: str) -> str:
    return f"(document.querySelector({selector!r})?.innerText ?? '')"


def says(selector: str, words: str) -> str:
    return f"{text(selector)}.includes({words!r})"


# What has less contrast than WCAG's level AA asks for: 4.5, or 3 for large text.
CONTRAST = """
(() => {
  const canvas = document.createElement("canvas").getContext("2d", { willReadFrequently: true });
  const rgba = (colour) => {
    canvas.clearRect(0, 0, 1, 1);
    canvas.fillStyle = colour;
    canvas.fillRect(0, 0, 1, 1);
    return [...canvas.getImageData(0, 0, 1, 1).data];
  };
  const light = (colour) => {
    const part = (one) => (one /= 255) <= 0.04045 ? one / 12.92 : ((one + 0.055) / 1.055) ** 2.4;
    const [red, green, blue] = colour.map(part);
    return 0.2126 * red + 0.7152 * green + 0.0722 * blue;
  };
  const ground = (one) => {
    for (let at = one; at; at = at.parentElement) {
      const colour = rgba(getComputedStyle(at).backgroundColor);
      if (colour[3] === 255) return colour;
    }
    return [255, 255, 255];
  };
  const found = [];
  const walker = document.createTreeWalker(document.body, NodeFilter.SHOW_TEXT);
  while (walker.nextNode()) {
    const one = walker.currentNode.parentElement;
    const unseen = one.closest(".hidden, .skip, svg, noscript, :disabled");
    if (!walker.currentNode.data.trim() || unseen) continue;
    const style = getComputedStyle(one);
    const [a, b] = [light(rgba(style.color)), light(ground(one))];
    const ratio = (Math.max(a, b) + 0.05) / (Math.min(a, b) + 0.05);
    if (ratio < (parseFloat(style.fontSize) >= 24 ? 3 : 4.5)) {
      found.push(`${walker.currentNode.data.trim()}: ${ratio.toFixed(2)} (${one.className})`);
    }
  }
  return found;
})()
"""
