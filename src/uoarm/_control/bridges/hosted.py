"""Starting a bridge in a host, where the configuration says so."""

from __future__ import annotations

from uoarm._control.bridges.machines import Machines, StagedMachines
from uoarm._control.bridges.restarts import Restarts
from uoarm._origin import install_command
from uoarm.bridge import Bridge
from uoarm.errors import BridgeError, FailureReason, PluginError
from uoarm.model import BridgeSpec, Options

__all__ = ["start_hosted"]


def start_hosted(
    spec: BridgeSpec,
    host: Options,
    restarts: Restarts,
    machines: Machines | StagedMachines,
    origin: str,
) -> Bridge:
    """Start the host of a bridge, or find it on its machine, and return when it is ready.

    Args:
        spec: the bridge.
        host: the settings of its host, see `HostSettings`.
        restarts: what is known of earlier deaths.
        machines: other machines; what runs there is never started from here.
        origin: the configuration file, which the host's command line shows.

    Raises:
        PluginError: the extra `uoarm[hosts]`, or the plugin in the host, is missing.
        BridgeError: the host could not be started, or died too often.
    """
    try:
        from uoarm._host import HostSettings, RemoteBridge  # noqa: PLC0415 - needs an extra
    except ImportError as error:
        command = install_command("uoarm", "hosts")
        text = f"bridge {spec.name!r} has a host, which needs: {command} ({error})"
        raise PluginError(text) from error
    if "machine" in host:
        return RemoteBridge(spec, machines.registry())
    restarts.check(spec.name, HostSettings.read(host).restarts)
    restarts.began(spec.name)
    try:
        return RemoteBridge(spec, origin=origin)
    except BridgeError as error:
        if error.reason in {FailureReason.UNAVAILABLE, FailureReason.TIMEOUT}:
            restarts.died(spec.name, str(error))
        raise
