"""What agents get: answers; messages, exact where they are short, else a summary with links."""

from __future__ import annotations

import base64
import io
import secrets
import statistics
import threading
from collections import OrderedDict
from collections.abc import Mapping, Sequence
from contextlib import suppress
from typing import Any

import orjson
from attrs import evolve, frozen
from mcp_types import CallToolResult, ImageContent, ResourceLink, TextContent

from uoarm.bridge import foreign, text_of
from uoarm.errors import MessageError, PluginError, UsageError
from uoarm.model import MOST_OCTETS, Message, plain_copy
from uoarm.server.front_end import TEXT_FORM, Account, Charge, MemoryUse, code_of, coded_text

KEPT = "uoarm://kept/"
_SHORT = 16_384
_SHORT_OCTETS = 1_024
_MOST_KEPT = 64
_MOST_OCTETS = 33_554_432
_LONG_LIST = 16
_LONG_TEXT = 1_000
_SHOWN = 3
_DEPTH = 12
_WIDEST = 1_024
_JPEG_OCTETS = 262_144
_QUALITIES = (80, 60, 40, 25)
_RAW = {"rgb8": "RGB", "bgr8": "BGR", "mono8": "L", "rgba8": "RGBA", "bgra8": "BGRA"}
_PIXELS = 64_000_000
# What cameras send; of the others that Pillow knows, one hands the octets to Ghostscript.
_FORMATS = ("BMP", "JPEG", "PNG", "WEBP")
# One picture at a time: unpacked, a large one takes 200 MB, and there may be as many as clients.
_unpacking = threading.Lock()


@frozen
class RenderedMessage:
    """One message for an agent.

    Attributes:
        value: as JSON; where `is_summary`, not the message itself.
        is_summary: whether it was too long.
        links: to what was left out.
        left_out: the octets of each link, until `KeptValues.keep` has them.
    """

    value: Any
    is_summary: bool = False
    links: tuple[ResourceLink, ...] = ()
    left_out: tuple[bytes, ...] = ()


class KeptValues:
    """What was too long to be shown, for a while: the newest, bounded in number and octets.

    In the server's loop, as the account is.

    Args:
        account: charged for it.
    """

    def __init__(self, account: Account) -> None:
        self._account = account
        self._kept: OrderedDict[str, tuple[str, bytes, Charge]] = OrderedDict()

    def find(self, uri: str) -> tuple[str, bytes] | None:
        """Return the kind and the octets of what is kept."""
        found = self._kept.get(uri)
        return None if found is None else found[:2]

    def has(self, rendered: RenderedMessage) -> bool:
        """Say whether all that a message leaves out is kept still."""
        return all(link.uri in self._kept for link in rendered.links)

    def uris(self) -> list[tuple[str, str, int]]:
        """Return what is kept: address, kind and octets."""
        return [(uri, kind, len(octets)) for uri, (kind, octets, _) in self._kept.items()]

    def keep(self, rendered: RenderedMessage) -> RenderedMessage:
        """Keep what a message leaves out, in the place of the oldest where there is no room.

        Raises:
            LimitError: the client holds too much memory.
        """
        for link, octets in zip(rendered.links, rendered.left_out, strict=True):
            charge = self._account.charge(MemoryUse.ANSWERS, len(octets))
            self._kept[link.uri] = link.mime_type or "", octets, charge
            while len(self._kept) > 1 and (
                len(self._kept) > _MOST_KEPT or self._octets() > _MOST_OCTETS
            ):
                _, (_, _, oldest) = self._kept.popitem(last=False)
                oldest.release()
        return evolve(rendered, left_out=())

    def _octets(self) -> int:
        return sum(len(octets) for _, octets, _ in self._kept.values())


def render(message: Message) -> RenderedMessage:
    """Return a message as an agent gets it; takes its time, for any thread.

    Raises:
        MessageError: it has no form as text.
    """
    try:
        return foreign(_render, message)
    except MessageError:
        raise
    except Exception as error:
        text = f"the message has no form for an agent: {text_of(error)}"
        raise MessageError(text) from error


def _render(message: Message) -> RenderedMessage:
    left = MOST_OCTETS

    def bounded(value: Any) -> Any:
        nonlocal left
        left -= getattr(value, "nbytes", 0)
        if left < 0:
            raise MessageError(f"its arrays have more than {MOST_OCTETS:,} octets")
        return value

    message = plain_copy(message, bounded)  # values of a component's own classes may have no end
    octets: list[bytes] = []
    _find_octets(message, octets, _DEPTH)
    if sum(map(len, octets)) <= _SHORT_OCTETS:
        text = TEXT_FORM.write(message)
        if len(text) <= _SHORT:
            return RenderedMessage(orjson.loads(text))
    summary = _Summary()
    value = summary.of(message, _DEPTH)
    if summary.is_cut or not summary.links:
        summary.leave_out("application/json", TEXT_FORM.write(message))
    return RenderedMessage(value, True, tuple(summary.links), tuple(summary.left_out))


class _Summary:
    """What is shown of a message that is too long.

    Attributes:
        links: to octets, which are left out.
        left_out: these.
        is_cut: whether something else is left out.
    """

    def __init__(self) -> None:
        self.links: list[ResourceLink] = []
        self.left_out: list[bytes] = []
        self.is_cut = False

    def leave_out(self, kind: str, octets: bytes) -> str:
        """Have a link in the place of octets; return its address."""
        name = secrets.token_hex(8)
        uri = f"{KEPT}{name}"
        self.links.append(ResourceLink(uri=uri, name=name, mime_type=kind, size=len(octets)))
        self.left_out.append(octets)
        return uri

    def of(self, value: Message, depth: int) -> Any:
        """Return what is shown of a value."""
        if _is_octets(value):
            link = self.leave_out("application/octet-stream", bytes(value))
            return {"octets": len(value), "link": link}
        if isinstance(value, Mapping):
            if depth == 0:
                self.is_cut = True
                return {"names": len(value)}
            self.is_cut |= len(value) > _MOST_KEPT
            return {
                str(name): self.of(part, depth - 1)
                for name, part in list(value.items())[:_MOST_KEPT]
            }
        if isinstance(value, str):
            if len(value) <= _LONG_TEXT:
                return value
            self.is_cut = True
            return {"text": value[:_LONG_TEXT], "of": len(value)}
        if isinstance(value, bool | int | float) or value is None:
            return _as_text(value)
        return self._of_list(value, depth)

    def _of_list(self, value: Message, depth: int) -> Any:
        shape = list(getattr(value, "shape", ()))
        if getattr(value, "size", 0) > _LONG_LIST and value.dtype.kind in "iuf":
            self.is_cut = True
            return _of_array(value)
        values: Sequence[Any] = value if isinstance(value, list | tuple) else _flat(value)
        if len(values) <= _LONG_LIST and depth and not shape[1:]:
            return [self.of(part, depth - 1) for part in values]
        self.is_cut = True
        summary: dict[str, Any] = {"length": len(values)}
        if shape:
            summary["shape"] = shape
        numbers = [
            part for part in values if isinstance(part, int | float) and not isinstance(part, bool)
        ]
        if len(numbers) == len(values):
            finite = [part for part in numbers if abs(part) < float("inf")]
            if finite:
                summary |= {"least": _as_text(min(finite)), "greatest": _as_text(max(finite))}
                with suppress(OverflowError):  # beyond what a float has room for
                    summary["mean"] = statistics.fmean(finite)
            return summary | {"first": _as_text(numbers[:_SHOWN])}
        return summary | {"first": [self.of(part, 1) for part in values[:_SHOWN]] if depth else []}


def _of_array(value: Any) -> dict[str, Any]:
    """Return the summary of numbers in an array, of which no list is made: it may be a map."""
    import numpy as np  # noqa: PLC0415 - an optional package, which is there where an array is

    flat = value.reshape(-1)
    summary: dict[str, Any] = {"length": flat.size, "shape": list(value.shape)}
    finite = flat[np.isfinite(flat)] if value.dtype.kind == "f" else flat
    if finite.size:
        with np.errstate(over="ignore"):
            mean = finite.mean(dtype=float).item()
        least, greatest = finite.min().item(), finite.max().item()
        summary |= {"least": _as_text(least), "greatest": _as_text(greatest)}
        if np.isfinite(mean):
            summary["mean"] = mean
    return summary | {"first": _as_text(flat[:_SHOWN].tolist())}


def _is_octets(value: Message) -> bool:
    """Say whether a value is octets, as a row of `uint8` is in every form of a message."""
    return isinstance(value, bytes | bytearray | memoryview) or (
        getattr(value, "dtype", None) == "uint8" and value.ndim == 1
    )


def _as_text(value: Message) -> Any:
    """Return numbers as they are in JSON text, where not every one is a number."""
    return orjson.loads(TEXT_FORM.write(value))


def _flat(value: Message) -> list[Any]:
    """Return the numbers of an array, whatever it is of."""
    listed: Any = getattr(value, "ravel", lambda: value)()
    found: list[Any] = listed.tolist()
    return found


def _find_octets(value: Message, found: list[bytes], depth: int) -> None:
    if _is_octets(value):
        found.append(bytes(value[: _SHORT_OCTETS + 1]))
    elif isinstance(value, Mapping) and depth:
        for part in value.values():
            _find_octets(part, found, depth - 1)
    elif isinstance(value, list | tuple) and depth:
        for part in value[:_MOST_KEPT]:
            _find_octets(part, found, depth - 1)


def is_picture(message: Message) -> bool:
    """Say whether a message is a picture, packed or not."""
    data = message.get("data") if isinstance(message, Mapping) else None
    return _is_octets(data) or getattr(data, "dtype", None) == "uint8"


def picture_of(message: Message) -> ImageContent:
    """Return a picture as a bounded JPEG; takes its time.

    Raises:
        PluginError: Pillow is not installed.
        UsageError: it is no picture that is known here.
    """
    try:
        written = foreign(_jpeg_of, message)
    except (PluginError, UsageError):
        raise
    except Exception as error:  # a decoder's, for octets that are none of its, or are damaged
        raise UsageError(f"it is no picture that can be shown: {text_of(error)}") from error
    return ImageContent(data=base64.b64encode(written).decode(), mime_type="image/jpeg")


def _jpeg_of(message: Message) -> bytes:
    try:
        from PIL import Image  # noqa: PLC0415 - an optional package
    except ImportError:
        raise PluginError(
            "pictures need Pillow: install the extra `pictures` of uoarm-mcp"
        ) from None
    width, height = message.get("width"), message.get("height")
    encoding = str(message.get("encoding", "rgb8"))
    with _unpacking:
        if getattr(message["data"], "nbytes", 0) > MOST_OCTETS:  # its octets repeat, perhaps
            raise UsageError("the picture is too large to be shown")
        data = bytes(message["data"])
        if isinstance(width, int) and isinstance(height, int):
            kind = _RAW.get(encoding)
            if kind is None or not 0 < width * height <= _PIXELS:
                raise UsageError(f"pictures of encoding {encoding!r:.50} are not shown")
            mode = kind.replace("BGR", "RGB")
            step = message.get("step")
            stride = step if isinstance(step, int) else 0
            picture = Image.frombuffer(mode, (width, height), data, "raw", kind, stride, 1)
        else:
            picture = Image.open(io.BytesIO(data), formats=_FORMATS)
            if picture.width * picture.height > _PIXELS:
                raise UsageError("the picture is too large to be shown")
            picture.draft("RGB", (_WIDEST, _WIDEST))  # of a JPEG no more is unpacked
        picture = picture.convert("RGB")
        picture.thumbnail((_WIDEST, _WIDEST))
    for quality in _QUALITIES:
        written = io.BytesIO()
        picture.save(written, "JPEG", quality=quality)
        if written.getbuffer().nbytes <= _JPEG_OCTETS:
            break
    return written.getvalue()


def succeeded(
    facts: dict[str, Any],
    links: Any = (),
    pictures: Any = (),
    *,
    is_error: bool = False,
) -> CallToolResult:
    """Return what a tool answers, as data and as text."""
    text = orjson.dumps(facts, option=orjson.OPT_NON_STR_KEYS).decode()
    content: list[TextContent | ResourceLink | ImageContent] = [TextContent(text=text)]
    return CallToolResult(
        content=[*content, *links, *pictures], structured_content=facts, is_error=is_error
    )


def failure_text(error: BaseException) -> str:
    """Return an error as agents get it: its kind, its text and its code."""
    return f"{code_of(error)}: {coded_text(error)}"


def failed(text: str) -> CallToolResult:
    """Return what a tool answers that refuses."""
    return CallToolResult(content=[TextContent(text=text)], is_error=True)
