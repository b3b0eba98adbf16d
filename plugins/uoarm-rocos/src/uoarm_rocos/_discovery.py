"""Facts about this machine for `uoarm doctor`."""

from __future__ import annotations

import shutil
from importlib.metadata import PackageNotFoundError, version

from uoarm.bridge import install_command

__all__ = ["doctor"]


def doctor() -> dict[str, str]:
    """Return what there is for devices and speech, name to finding; opens no port."""
    import serial  # noqa: PLC0415 - not needed to load the plugin
    from serial.tools.list_ports import comports  # noqa: PLC0415 - the same

    ports = [f"{port.device} ({port.description})" for port in comports()]
    try:
        espeak = f"espeakng-loader {version('espeakng-loader')} (GPL-3.0-or-later)"
    except PackageNotFoundError:
        espeak = f"not installed: {install_command('uoarm-rocos', 'speech')}"
    festival = shutil.which("text2wave") or "not installed: apt install festival festvox-kallpc16k"
    return {
        "pyserial": str(serial.__version__),
        "serial ports": ", ".join(ports) or "none",
        "eSpeak NG": espeak,
        "Festival": festival,
        "aplay": shutil.which("aplay") or "not installed: speech is written to files",
    }
