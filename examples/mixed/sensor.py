"""A thermometer on an MQTT broker, whose URL is its argument. It knows nothing of uoarm."""

from __future__ import annotations

import json
import sys
import time
from urllib.parse import urlsplit

from paho.mqtt.client import Client
from paho.mqtt.enums import CallbackAPIVersion


def main() -> None:
    """Publish on lab/temperature until interrupted."""
    place = urlsplit(sys.argv[1])
    client = Client(CallbackAPIVersion.VERSION2)
    client.connect(place.hostname or "127.0.0.1", place.port or 1883)
    client.loop_start()
    while True:
        client.publish("lab/temperature", json.dumps({"celsius": 21.5}), retain=True)
        time.sleep(0.2)


if __name__ == "__main__":
    main()
