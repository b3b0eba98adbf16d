"""Face detection as an RT-Component in a process of its own, found by the naming service.

It has an InPort `image` (HealthBot::View) and an OutPort `faces` (HealthBot::Faces), and is driven
by what activates it, be that uoarm, RT System Editor or rtshell.
"""

from __future__ import annotations

import queue
import signal
import sys
import threading
from pathlib import Path
from typing import Any

from healthbot_parts.finding import FaceFinder, picture_of
from uoarm_rtm.component import ComponentProfile, NamingService, Orb, RtComponent, Types

_NAME = "FaceDetector0"
_IDL = Path(__file__).parents[1] / "faces.idl"
_SECONDS = 2.0
_FIELDS = ("width", "height", "encoding", "data")


class Detector:
    """The component; pictures that come while one is searched replace each other.

    Args:
        nameserver: where it binds itself.
    """

    def __init__(self, nameserver: str) -> None:
        types = Types([str(_IDL)])
        self._orb = Orb("127.0.0.1", _SECONDS)
        self._finder = FaceFinder()
        self._waiting: queue.Queue[Any] = queue.Queue(maxsize=1)
        profile = ComponentProfile(
            _NAME, "FaceDetector", "finds faces in pictures", category="Vision"
        )
        self._component = RtComponent(self._orb, profile)
        self._component.add_in_port("image", "HealthBot::View", types, self._take)
        self._faces = self._component.add_out_port("faces", "HealthBot::Faces", types)
        self._component.bind([NamingService(self._orb, nameserver, _SECONDS)])

    def run(self, stop: threading.Event) -> None:
        """Search pictures until a signal comes, or until the component is ended."""
        while not stop.is_set() and not self._component.wait_for_exit(0):
            try:
                image = self._waiting.get(timeout=0.2)
            except queue.Empty:
                continue
            try:
                picture = picture_of(**{name: image[name] for name in _FIELDS})
            except ValueError as error:
                print(f"a picture is passed over: {error}", file=sys.stderr)
                continue
            self._faces.write(self._finder.find(picture))

    def close(self) -> None:
        """Leave the naming service."""
        self._component.close()
        self._orb.close()

    def _take(self, image: Any) -> None:
        while True:
            try:
                self._waiting.put_nowait(image)
            except queue.Full:
                try:
                    self._waiting.get_nowait()
                except queue.Empty:
                    continue
            else:
                return


def main() -> None:
    """Serve the component in the naming service named on the command line."""
    stop = threading.Event()
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: threading.Thread(target=stop.set).start())
    detector = Detector(sys.argv[1])
    print("ready", flush=True)
    try:
        detector.run(stop)
    finally:
        detector.close()


if __name__ == "__main__":
    main()
