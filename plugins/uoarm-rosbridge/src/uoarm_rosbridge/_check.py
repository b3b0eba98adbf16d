"""What `uoarm doctor` says of this plugin; it imports nothing of the server's packages itself."""

from __future__ import annotations

from uoarm.bridge import install_command
from uoarm.errors import PluginError
from uoarm.plugins import Check, hookimpl


def _run() -> dict[str, str]:
    try:
        from uoarm_rosbridge._front_end import uoarm_front_ends  # noqa: PLC0415 - what is checked
    except ImportError as error:
        command = install_command("uoarm", "server")
        raise PluginError(f"the server's packages are needed ({error}): {command}") from error
    [front_end] = uoarm_front_ends()
    return {"endpoint": f"{front_end.path} of uoarm serve"}


@hookimpl
def uoarm_checks() -> list[Check]:
    """Return the check of this plugin."""
    return [Check("rosbridge server", _run, contract=1)]
