"""Environments of their own for the bridges to ROS 2 and OpenRTM, made where they are missing."""

from __future__ import annotations

from collections.abc import Callable

from attrs import frozen

from uoarm import environments

__all__ = ["HOSTS", "Progress", "Wanted", "prepare_environments"]

Progress = Callable[[str], None]
"""Takes one line of progress."""

_BECAUSE, _WIDE = " (", 90
_DRAWN = ("Collecting ", "Building ", "Installing ", "Successfully ", "Resolved ", "Installed ")


@frozen
class Wanted:
    """One environment.

    Attributes:
        name: of the environment.
        plugin: that runs in it.
        distribution: of the plugin's middleware, None where there is one only.
    """

    name: str
    plugin: str
    distribution: str | None = None


HOSTS = {
    "ros_host": Wanted("healthbot-jazzy", "ros2", "jazzy"),
    "rtm_host": Wanted("healthbot-rtm", "rtm"),
}
"""What stands for the host of each bridge in robot.yaml."""


def prepare_environments(progress: Progress) -> None:
    """Make every environment that is missing, cut short, or made of something else.

    Args:
        progress: called with each step of it, and each package.

    Raises:
        PluginError: one could not be made; the text has the last lines of what failed.
    """
    there = {environment.name: environment for environment in environments.listed()}
    for wanted in HOSTS.values():
        requirements = environments.requirements(wanted.plugin, wanted.distribution)
        found = there.get(wanted.name)
        if found is not None and found.is_whole and found.requirements == requirements:
            continue
        if found is not None:
            environments.remove(wanted.name)
        progress(f"Making the environment {wanted.name} for {wanted.plugin} (once) ...")
        environments.create(wanted.name, requirements, progress=lambda line: _draw(line, progress))


def _draw(line: str, progress: Progress) -> None:
    text = line.strip()
    if text.startswith(_DRAWN):
        progress(f"  {text.partition(_BECAUSE)[0][:_WIDE]}")
