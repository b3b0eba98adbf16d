"""The command `uoarm host`: one bridge of a configuration, run for tools of other kinds."""

from __future__ import annotations

import threading

import click

from uoarm.bridge import Registry
from uoarm.cli._shared import configuration_option, reporting
from uoarm.config import load
from uoarm.errors import PluginError, UsageError
from uoarm.model import Component, Endpoint

__all__ = ["host"]


@click.command()
@click.argument("bridge")
@click.option("--xmlrpc", "port", type=click.IntRange(0, 65535), required=True, help="Its port.")
@configuration_option
def host(bridge: str, port: int, file: str) -> None:
    """Answer over XML-RPC what BRIDGE knows of its components, until interrupted."""
    with reporting():
        try:
            from uoarm.host import RemoteBridge, XmlRpcFace  # noqa: PLC0415 - needs an extra
        except ImportError as error:
            raise PluginError(f"this needs: pip install 'uoarm[hosts]' ({error})") from error
        registry = Registry()
        robot = load(file, registry.types)
        spec = robot.bridges.get(bridge)
        if spec is None:
            raise UsageError(f"there is no bridge {bridge!r}: {', '.join(robot.bridges)}")
        made = registry.create(spec) if spec.host is None else RemoteBridge(spec)
        try:
            mine = (one for one in robot.components() if one.bridge == bridge)
            face = XmlRpcFace(made, (end for one in mine for end in _endpoints(one)), port)
            click.echo(f"bridge {bridge} answers at http://127.0.0.1:{face.port}/RPC2")
            try:
                threading.Event().wait()
            finally:
                face.close()
        finally:
            made.close()


def _endpoints(component: Component) -> list[Endpoint]:
    if component.service is not None:
        return [component.service.endpoint]
    inputs = [port.endpoint for port in component.inputs]
    return [*inputs, *(port.endpoint for port in component.outputs)]
