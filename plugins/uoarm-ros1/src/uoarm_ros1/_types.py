"""Types of ROS 1: where their definitions are found, their structures, and what serialises."""

from __future__ import annotations

import os
import re
import struct
import threading
from collections.abc import Callable, Iterable, Mapping
from functools import lru_cache
from pathlib import Path

from attrs import frozen

from uoarm.bridge import Description
from uoarm.cdr import ROS_1, Codec
from uoarm.errors import BridgeError, ConfigurationError, FailureReason
from uoarm.model import Budget, Message
from uoarm_ros1._definitions import (
    DefinitionError,
    RosRecord,
    RosService,
    record_of,
    service_of,
)

_MAX_FILES = 20_000
_MAX_OCTETS = 1 << 20
_SYSTEM = ("/usr/share", "/opt/ros/*/share")
_RULE = "\n" + "=" * 80 + "\nMSG: "

# What no package of rosbags has, and many robots do.
_OWN_MESSAGES = {
    "roscpp/Logger": "string name\nstring level\n",
    "tf2_msgs/TFMessage": "geometry_msgs/TransformStamped[] transforms\n",
    "tf2_msgs/TF2Error": (
        "uint8 NO_ERROR = 0\nuint8 LOOKUP_ERROR = 1\nuint8 CONNECTIVITY_ERROR = 2\n"
        "uint8 EXTRAPOLATION_ERROR = 3\nuint8 INVALID_ARGUMENT_ERROR = 4\n"
        "uint8 TIMEOUT_ERROR = 5\nuint8 TRANSFORM_ERROR = 6\n\nuint8 error\nstring error_string\n"
    ),
}
_OWN_SERVICES = {
    "roscpp/Empty": "---\n",
    "roscpp/GetLoggers": "---\nLogger[] loggers\n",
    "roscpp/SetLoggerLevel": "string logger\nstring level\n---\n",
    "std_srvs/Empty": "---\n",
    "std_srvs/SetBool": "bool data\n---\nbool success\nstring message\n",
    "std_srvs/Trigger": "---\nbool success\nstring message\n",
}
_ACTION_PARTS = {
    "ActionGoal": "Header header\nactionlib_msgs/GoalID goal_id\n{name}Goal goal\n",
    "ActionResult": "Header header\nactionlib_msgs/GoalStatus status\n{name}Result result\n",
    "ActionFeedback": "Header header\nactionlib_msgs/GoalStatus status\n{name}Feedback feedback\n",
}


@frozen
class ActionType:
    """The three messages with which a client and a server of an action speak."""

    goal: RosRecord
    result: RosRecord
    feedback: RosRecord


class TypeStore:
    """Definitions by the name of their type; each is looked for when it is asked for.

    Args:
        folders: of the configuration; what they say goes before all else.
    """

    def __init__(self, folders: Iterable[str]) -> None:
        self._texts: dict[str, dict[str, str]] = {"msg": {}, "srv": {}}
        for folder in folders:
            path = Path(folder)
            if not os.path.isdir(path):
                raise ConfigurationError(f"definitions: {folder} is no folder")
            files = [f for f in sorted(path.rglob("*")) if f.suffix in _SUFFIXES]
            self._take(path, [f for f in files if not f.is_dir()])
        # Guards the search of what is installed, which is made once, when a type is not known.
        self._lock = threading.Lock()
        self._has_looked = False
        self._installed: TypeStore | None = None

    def message(self, name: str) -> RosRecord | None:
        """Return a message type, None where its definition is nowhere.

        Raises:
            BridgeError: the definition, or one within it, cannot be read.
        """
        text = self.text(name)
        if text is None:
            return None
        try:
            return record_of(name, self._whole(name, text))
        except DefinitionError as error:
            raise BridgeError(str(error), FailureReason.UNSUPPORTED) from error

    def service(self, name: str, given: str = "") -> RosService | None:
        """Return a service type, None where its definition is nowhere.

        Args:
            name: `package/Name`.
            given: its text, where the configuration has it.

        Raises:
            BridgeError: the definition, or one within it, cannot be read.
        """
        text = given or self._found("srv", name)
        text = _OWN_SERVICES.get(name) if text is None else text
        if text is None:
            return None
        try:
            return service_of(name, text, self.text)
        except DefinitionError as error:
            raise BridgeError(str(error), FailureReason.UNSUPPORTED) from error

    def require(self, name: str, given: str = "") -> RosRecord:
        """Return a message type.

        Args:
            name: `package/Name`.
            given: its definition, where the configuration has it.

        Raises:
            BridgeError: there is no definition, with what to do; or it cannot be read.
        """
        if given:
            try:
                return record_of(name, self._whole(name, given))
            except DefinitionError as error:
                raise BridgeError(str(error), FailureReason.BAD_ENDPOINT) from error
        found = self.message(name)
        if found is None:
            raise missing(name, "msg")
        return found

    def require_service(self, name: str, given: str = "") -> RosService:
        """Return a service type.

        Raises:
            BridgeError: there is no definition, with what to do; or it cannot be read.
        """
        found = self.service(name, given)
        if found is None:
            raise missing(name, "srv")
        return found

    def action(self, name: str) -> ActionType:
        """Return an action type, `package/NameAction`.

        Raises:
            BridgeError: there is no definition, with what to do; or it cannot be read.
        """
        stem = name.removesuffix("Action")
        goal, result, feedback = (self.message(f"{stem}{ending}") for ending in _ACTION_PARTS)
        if goal is None or result is None or feedback is None:
            raise missing(stem, "action")
        return ActionType(goal, result, feedback)

    def text(self, name: str) -> str | None:
        """Return the text of one message type alone, without those within it."""
        found = self._found("msg", name)
        return _OWN_MESSAGES.get(name) or noetic_definition(name) if found is None else found

    def _found(self, kind: str, name: str) -> str | None:
        """Return the text of a file, of the configuration's folders or of what is installed."""
        if name in self._texts[kind]:
            return self._texts[kind][name]
        installed = self._look()
        return None if installed is None else installed._texts[kind].get(name)  # noqa: SLF001

    def _whole(self, name: str, text: str) -> str:
        """Return a definition with those of all types that are found for it."""
        if _RULE in text:
            return text
        wanted, parts = [name], {name: text}
        while wanted:
            outer = wanted.pop()
            for inner in _types_within(outer, parts[outer]):
                found = None if inner in parts else self.text(inner)
                if found is not None:
                    parts[inner] = found
                    wanted.append(inner)
        return text + "".join(f"{_RULE}{inner}\n{parts[inner]}" for inner in [*parts][1:])

    def _look(self) -> TypeStore | None:
        """Read what is installed on this machine, once."""
        with self._lock:
            if not self._has_looked:
                self._has_looked = True
                installed = TypeStore(())
                installed._has_looked = True
                for folder in installed_folders(os.environ):
                    for kind in _SUFFIXES.values():
                        found = sorted(folder.glob(f"*/{kind}/*.{kind}"))
                        installed._take(folder, [f for f in found if _is_readable(f)])
                self._installed = installed
        return self._installed

    def _take(self, folder: Path, files: list[Path]) -> None:
        if len(files) > _MAX_FILES:
            text = f"{folder} holds {len(files):,} definitions, more than {_MAX_FILES:,}"
            raise ConfigurationError(text)
        for path in files:
            if path.exists() and not path.is_file():  # but a pipe, on which this would wait
                text = f"definitions: {path} cannot be read: no regular file"
                raise ConfigurationError(text)
            try:
                if path.stat().st_size > _MAX_OCTETS:
                    continue
                text = path.read_text("utf-8", "replace")
            except OSError as error:
                why = error.strerror or error
                raise ConfigurationError(f"definitions: {path} cannot be read: {why}") from error
            kind = _SUFFIXES[path.suffix]
            package = (path.parent.parent if path.parent.name == kind else path.parent).name
            name = f"{package}/{path.stem}"
            if kind == "action":
                self._take_action(name, text)
            else:
                self._texts[kind][name] = text

    def _take_action(self, name: str, text: str) -> None:
        parts = re.split(r"^---[ \t]*$", text.replace("\r\n", "\n"), flags=re.MULTILINE)
        if len(parts) != 3:  # noqa: PLR2004 - a goal, a result and feedback
            return
        for ending, part in zip(("Goal", "Result", "Feedback"), parts, strict=True):
            self._texts["msg"][f"{name}{ending}"] = part.strip("\n") + "\n"
        for ending, template in _ACTION_PARTS.items():
            own = name.partition("/")[2]
            self._texts["msg"][f"{name}{ending}"] = template.format(name=own)


def _is_readable(path: Path) -> bool:
    """Whether there is a file to read; what is installed may have links to what was removed."""
    return path.is_file() and os.access(path, os.R_OK)


_SUFFIXES = {".msg": "msg", ".srv": "srv", ".action": "action"}


def missing(name: str, kind: str) -> BridgeError:
    """Return the error that a definition is nowhere, with what to do."""
    file = f"{name.replace('/', f'/{kind}/')}.{kind}"
    return BridgeError(
        f"there is no definition of {name}: name a folder that holds {file} in the bridge's option "
        f"`definitions`, or put its text into the endpoint's option `definition`",
        FailureReason.UNSUPPORTED,
    )


def installed_folders(environment: Mapping[str, str]) -> list[Path]:
    """Return the folders of packages that an installation of ROS 1 has here."""
    named = [Path(part) for part in environment.get("ROS_PACKAGE_PATH", "").split(":") if part]
    system = [path for pattern in _SYSTEM for path in sorted(Path("/").glob(pattern[1:]))]
    return [path for path in (*system, *named) if path.is_dir()]


@lru_cache(maxsize=1024)
def noetic_definition(name: str) -> str | None:
    """Return the text of a type of Noetic's own packages, as rosbags has it."""
    package, _, own = name.partition("/")
    store = _noetic()
    full = f"{package}/msg/{own}"
    if full not in store.fielddefs:
        return None
    text, _ = store.generate_msgdef(full, ros_version=1)
    return str(text).partition("\n====")[0] + "\n"


@lru_cache(maxsize=1)
def _noetic():  # type: ignore[no-untyped-def]  # noqa: ANN202 - a class of rosbags
    from rosbags.typesys import Stores, get_typestore  # noqa: PLC0415 - takes a while

    return get_typestore(Stores.ROS1_NOETIC)


def _types_within(name: str, text: str) -> list[str]:
    """Return the message types that one holds, by their full names."""
    found = []
    for line in text.split("\n"):
        word = line.split("#", 1)[0].strip().split(" ", 1)[0].partition("[")[0]
        if not word or not word[0].isalpha():
            continue
        if word == "Header":
            found.append("std_msgs/Header")
        elif "/" in word:
            found.append(word)
        elif word[0].isupper():
            found.append(f"{name.partition('/')[0]}/{word}")
    return found


LENGTH = struct.Struct("<I")
"""What stands before every message on a connection."""


def described_service(service: RosService) -> Description:
    """Return the structures of a service."""
    return Description(request=service.request.structure, reply=service.reply.structure)


def reader(record: RosRecord, budget: Budget) -> Callable[[bytes | bytearray], Message]:
    """Return the function that makes a message of its octets; it raises MessageError."""
    codec = Codec(record.structure, ROS_1, budget)
    return lambda octets: codec.decode(octets, "<")


def framed_writer(record: RosRecord) -> Callable[[Message], bytes]:
    """Return the function that serialises a message, with its length in front.

    It raises MessageError with the path of the member that does not fit.
    """
    write = Codec(record.structure, ROS_1).encode_parts

    def frame(message: Message) -> bytes:
        parts = write(message, "<")
        return b"".join((LENGTH.pack(sum(map(len, parts))), *parts))

    return frame
