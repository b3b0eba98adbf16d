"""What this plugin brings to a server: one session for each viewer."""

from __future__ import annotations

import asyncio
import functools
import time
from collections.abc import Callable, Mapping
from typing import Any, TypeVar

from uoarm import __version__
from uoarm.bridge import Log
from uoarm.errors import ControlMessageError, UoarmError
from uoarm.model import BudgetUse, message_octets
from uoarm.server.front_end import (
    TEXT_FORM,
    Backend,
    BusyError,
    Charge,
    Client,
    FeedKey,
    FrontEnd,
    LimitError,
    MakeSession,
    MemoryUse,
    MessageForm,
    Operation,
    Subscription,
    coded_text,
    hookimpl,
    without_frames,
)
from uoarm.server.publication import InputPublication
from uoarm_foxglove._catalogue import (
    NOTHING,
    ChannelCatalogue,
    ListingQuestion,
    OutputChannel,
    RobotService,
    VisibleListing,
)
from uoarm_foxglove._protocol import (
    CDR,
    JSON,
    ClientFrame,
    PublishedFrame,
    ServiceRequest,
    StatusLevel,
    list_of,
    message_data,
    number_of,
    read_as,
    read_frame,
    service_response,
    text_of,
    write,
)

T = TypeVar("T")
Fields = Mapping[str, Any]
_log = Log("uoarm.foxglove")
_LOOK_SECONDS = 1.0
_CAPABILITIES = [
    "clientPublish",
    "connectionGraph",
    "parameters",
    "parametersSubscribe",
    "services",
]
# By this viewers know the common types of ROS 2, and publish them; else goals have ROS 1's header.
# Of its newer distributions they do not distinguish one from another.
_OF_ROS_2 = {"ROS_DISTRO": "jazzy"}
_NOT_SERVED = {"fetchAsset": "assets are not served"}
_MOST_ERRORS = 3
_SHOWN = 256  # of a name that is wrong


class FoxgloveSession:
    """One client that speaks the Foxglove WebSocket protocol.

    What is wrong with a message is answered with a `status` of level error; a call that fails, with
    `serviceCallFailure`.
    """

    def __init__(self, client: Client, backend: Backend, catalogue: ChannelCatalogue) -> None:
        self._client, self._backend, self._catalogue = client, backend, catalogue
        self._listing = NOTHING
        self._graph: VisibleListing | None = None  # that the viewer has; None: it wants none
        self._look_now = asyncio.Event()
        # What comes before the first listing waits for it: a viewer that connects again advertises
        # at once what it publishes. None: there is a listing.
        self._early: list[tuple[ClientFrame, Charge]] | None = []
        self._subscriptions: dict[int, Subscription] = {}
        self._publications: dict[int, InputPublication] = {}
        self._calls: set[asyncio.Task[None]] = set()
        self._parameters: frozenset[str] = frozenset()  # whose changes it wants
        self._acts: dict[str, Callable[[Fields], None]] = {
            "subscribe": self._subscribe,
            "unsubscribe": self._unsubscribe,
            "advertise": self._advertise,
            "unadvertise": self._unadvertise,
            "subscribeConnectionGraph": self._subscribe_graph,
            "unsubscribeConnectionGraph": self._unsubscribe_graph,
            "getParameters": self._get_parameters,
            "setParameters": self._set_parameters,
            "subscribeParameterUpdates": self._subscribe_parameters,
            "unsubscribeParameterUpdates": self._unsubscribe_parameters,
        }
        plugins = {bridge.plugin for bridge in backend.robot.config.bridges.values()}
        info = {
            "name": f"uoarm {__version__}",
            "capabilities": _CAPABILITIES,
            "supportedEncodings": [CDR, JSON],
            "metadata": _OF_ROS_2 if "ros2" in plugins else {},
            "sessionId": catalogue.identity,  # a viewer that comes back goes on with what it has
        }
        client.outbox.reply(write("serverInfo", **info), text=True)
        self._showing = asyncio.ensure_future(self._show())
        self._showing.add_done_callback(self._take_end)

    def octets(self, frame: str | bytes) -> int:
        """Return how much there is to decode."""
        return len(frame)

    def decode(self, frame: str | bytes, spending: BudgetUse) -> tuple[Callable[[], None], int]:
        """Return what acts on one frame, and how much memory its message holds."""
        try:
            message = read_frame(frame, spending)
        except ControlMessageError as error:
            return functools.partial(self._fail, without_frames(error)), 0
        octets = message_octets(message) if isinstance(message, dict) else len(frame)
        return functools.partial(self._handle, message), octets

    def close(self) -> None:
        """Give back everything that only this client used."""
        self._showing.cancel()
        for call in self._calls:
            call.cancel()
        for subscription in self._subscriptions.values():
            subscription.close()
        for publication in self._publications.values():
            publication.abandon()
        for _, charge in self._early or ():
            charge.release()
        self._subscriptions.clear()
        self._publications.clear()

    async def _show(self) -> None:
        """Keep the viewer's list of channels and services, and its graph, as its role sees them."""
        while True:
            self._look_now.clear()
            asked = ListingQuestion(self._client.role, self._listing, self._graph, self._parameters)
            try:
                answer = await self._catalogue.answer(asked)
            except UoarmError as error:  # the server closes, or is busy
                _log.debug("a viewer is not shown what there is: %s", error)
            else:
                frames = answer.frames
                # Of those that were asked for meanwhile, too: from now on they are compared with
                # this listing.
                late = self._parameters - asked.names
                values = answer.listing.parameters_after(self._listing, late)
                if values is not None:
                    frames = (*frames, values)
                self._listing = answer.listing
                self._handle_early()
                # The viewer may have asked for the graph, or for no graph, meanwhile.
                if asked.graph is not None and self._graph is asked.graph:
                    self._graph = answer.listing
                for frame in frames:
                    await self._client.outbox.room(len(frame))
                    self._client.outbox.reply(frame, text=True)
            # Before CPython 3.12, `asyncio.wait_for` may lose the cancellation of `close`.
            timer = asyncio.get_running_loop().call_later(_LOOK_SECONDS, self._look_now.set)
            try:
                await self._look_now.wait()
            finally:
                timer.cancel()

    def _take_end(self, showing: asyncio.Task[None]) -> None:
        """Say that the viewer is shown nothing more, where that was not asked for."""
        error = None if showing.cancelled() else showing.exception()
        if error is not None:
            self._fail(error)

    def _handle_early(self) -> None:
        early, self._early = self._early or [], None
        for message, charge in early:
            charge.release()
            self._handle(message)

    def _keep(self, early: list[tuple[ClientFrame, Charge]], message: ClientFrame) -> None:
        """Keep what came before the first listing.

        Raises:
            BusyError: too many wait.
            LimitError: the client has too much memory held.
        """
        most = self._client.limits.queue_messages
        if len(early) >= most:
            raise BusyError(f"{most} messages wait for the first listing already")
        early.append((message, self._client.account.charge(MemoryUse.ASKED, self._client.in_hand)))

    def _handle(self, message: ClientFrame) -> None:
        try:
            if self._early is not None:
                self._keep(self._early, message)
            elif isinstance(message, PublishedFrame):
                self._publish(message)
            elif isinstance(message, ServiceRequest):
                self._call(message)
            else:
                self._act(message)
        except Exception as error:  # noqa: BLE001 - every message that is wrong is answered
            self._fail(error)

    def _act(self, fields: Fields) -> None:
        op = fields.get("op")
        act = self._acts.get(op) if isinstance(op, str) else None
        if act is None:
            known = ", ".join(self._acts)
            why = _NOT_SERVED.get(str(op), f"expected one of {known}")
            raise ControlMessageError(f"op {op!r:.60}: {why}")
        try:
            act(fields)
        except Exception as error:  # noqa: BLE001 - every message that is wrong is answered
            self._fail(error, f"{op}: ")

    def _subscribe(self, fields: Fields) -> None:
        def subscribe(asked: Fields) -> None:
            number = number_of(asked, "id")
            channel = self._listing.channels[number_of(asked, "channelId", self._listing.channels)]
            if number in self._subscriptions:
                raise ControlMessageError(f"id: {number} is in use")
            if len(self._subscriptions) >= self._client.limits.streams:
                raise LimitError(f"{self._client.limits.streams} channels are subscribed already")
            self._client.require(Operation.REQUEST, channel.function)
            self._subscriptions[number] = self._subscription(number, channel)

        self._for_each(fields, "subscriptions", dict, subscribe)

    def _subscription(self, number: int, channel: OutputChannel) -> Subscription:
        """Return a subscription; viewers of one channel share all but the head of a frame."""
        topic, codec = channel.topic, channel.codec
        warn = functools.partial(self._warn, topic)

        def on_end(text: str) -> None:
            ended = self._subscriptions.pop(number, None)
            if ended is not None:
                ended.finish(self._written_status(StatusLevel.ERROR, f"{topic} {text}", topic))

        form = MessageForm(
            f"foxglove:{channel.number}",
            lambda _, message: codec.write(message),
            text=False,
            frames=lambda payload, _: (message_data(number, time.time_ns(), payload),),
        )
        subscription = Subscription(
            self._client,
            form,
            on_refused=lambda error: warn(coded_text(error)),
            on_end=lambda state, cause: on_end(f"has {state}: {cause or 'killed'}"),
        )
        subscription.follow(
            self._backend,
            FeedKey(channel.wanted),
            on_waiting=warn,
            on_failed=lambda error: on_end(coded_text(error)),
        )
        return subscription

    def _unsubscribe(self, fields: Fields) -> None:
        def unsubscribe(asked: int) -> None:
            number = number_of(asked, "id", self._subscriptions)
            self._subscriptions.pop(number).close()

        self._for_each(fields, "subscriptionIds", int, unsubscribe)

    def _advertise(self, fields: Fields) -> None:
        def advertise(asked: Fields) -> None:
            number, name = number_of(asked, "id"), text_of(asked, "topic")
            encoding = text_of(asked, "encoding")
            stated = text_of(asked, "schemaName") if "schemaName" in asked else ""
            topic = self._listing.inputs.get(name if name.startswith("/") else f"/{name}")
            if topic is None:
                # Not the most similar of all: to compare thousands would hold the loop up.
                parent = f"/{name.lstrip('/').partition('/')[0]}"
                called = "topics to publish to are called /FUNCTION, or /FUNCTION/INPUT of several"
                to_do = f"did you mean {parent!r}?" if parent in self._listing.inputs else called
                raise ControlMessageError(f"{name[:_SHOWN]}: there is no such input; {to_do}")
            if number in self._publications:
                raise ControlMessageError(f"id: {number} is in use")
            if len(self._publications) >= self._client.limits.streams:
                raise LimitError(f"{self._client.limits.streams} channels are advertised already")
            self._client.require(Operation.SEND, topic.function)
            # Not by its number: another one has that where this was withdrawn before it ended.
            publication = InputPublication(
                topic.function,
                topic.function,
                topic.port,
                read_as(encoding, self._client.limits.budget, stated),
                self._backend,
                self._client,
                on_ended=lambda error: self._publication_ended(number, publication, error),
            )
            self._publications[number] = publication

        self._for_each(fields, "channels", dict, advertise)

    def _publication_ended(
        self, number: int, publication: InputPublication, error: BaseException
    ) -> None:
        if self._publications.get(number) is publication:
            del self._publications[number]
            publication.abandon()
            self._fail(error)

    def _unadvertise(self, fields: Fields) -> None:
        def unadvertise(asked: int) -> None:
            self._publications.pop(number_of(asked, "id", self._publications)).close()

        self._for_each(fields, "channelIds", int, unadvertise)

    def _for_each(self, fields: Fields, name: str, kind: type[T], act: Callable[[T], None]) -> None:
        """Act on each item of a list: one that is wrong costs itself only.

        The first errors are reported, each with its place.
        """
        errors = 0
        for number, item in enumerate(list_of(fields, name, kind)):
            try:
                act(item)
            except Exception as error:  # noqa: BLE001 - every item that is wrong is answered
                errors += 1
                if errors <= _MOST_ERRORS:
                    self._fail(error, f"{fields['op']}: {name}.{number}: ")
        if errors > _MOST_ERRORS:
            self._fail(ControlMessageError(f"and {errors - _MOST_ERRORS} more are refused"))

    def _subscribe_graph(self, fields: Fields) -> None:
        del fields
        self._graph = NOTHING
        self._look_now.set()

    def _unsubscribe_graph(self, fields: Fields) -> None:
        del fields
        self._graph = None

    def _get_parameters(self, fields: Fields) -> None:
        self._reply_parameters(_names_in(fields), fields)

    def _set_parameters(self, fields: Fields) -> None:
        """Refuse it, and answer which values hold."""
        names = [text_of(item, "name") for item in list_of(fields, "parameters", dict)]
        self._reply_parameters(names, fields)
        raise ControlMessageError(
            "parameters are set by the configuration, so that two clients cannot want two values: "
            "change them there"
        )

    def _subscribe_parameters(self, fields: Fields) -> None:
        known = self._listing.parameters.keys()
        self._parameters |= known & set(_names_in(fields) or known)

    def _unsubscribe_parameters(self, fields: Fields) -> None:
        self._parameters -= set(_names_in(fields) or self._parameters)

    def _reply_parameters(self, names: list[str], fields: Fields) -> None:
        if len(self._calls) >= self._client.limits.calls:
            raise LimitError(f"{self._client.limits.calls} calls are under way")
        request = {"id": text_of(fields, "id")} if "id" in fields else {}
        charge = self._client.account.charge(MemoryUse.ASKED, self._client.in_hand)
        reply = asyncio.ensure_future(self._show_parameters(names, request, f"{fields['op']}: "))
        self._calls.add(reply)
        reply.add_done_callback(self._calls.discard)
        reply.add_done_callback(lambda _: charge.release())

    async def _show_parameters(self, names: list[str], request: dict[str, str], place: str) -> None:
        listing: VisibleListing | None = None
        while listing is not self._listing:  # or what has changed meanwhile would come before
            listing = self._listing
            made = functools.partial(listing.parameter_values, dict.fromkeys(names), **request)
            try:
                frame = await self._backend.in_worker(made)
            except Exception as error:  # noqa: BLE001 - every message is answered
                self._fail(error, place)
                return
            await self._client.outbox.room(len(frame))
        self._client.outbox.reply(frame, text=True)

    def _publish(self, message: PublishedFrame) -> None:
        publication = self._publications.get(message.channel)
        if publication is None:
            raise ControlMessageError(f"there is no channel {message.channel} of this client")
        publication.publish(message.payload, self._published, len(message.payload))

    def _published(self, error: BaseException | None) -> None:
        if error is not None:
            self._fail(error)

    def _call(self, request: ServiceRequest) -> None:
        try:
            service = self._admitted(request)
            charge = self._client.account.charge(MemoryUse.ASKED, len(request.payload))
        except Exception as error:  # noqa: BLE001 - answered as the call's
            self._call_failed(request, error)
            return
        call = asyncio.ensure_future(self._answer(request, service))
        self._calls.add(call)
        call.add_done_callback(self._calls.discard)
        call.add_done_callback(lambda _: charge.release())

    def _admitted(self, request: ServiceRequest) -> RobotService:
        """Return the service of a call, for which there is room and a right.

        Raises:
            ControlMessageError: there is no such service.
            LimitError: too many calls are under way.
            DeniedError: the client may not call it.
        """
        service = self._listing.services.get(request.service)
        if service is None:
            raise ControlMessageError(f"serviceId: there is no {request.service}")
        if len(self._calls) >= self._client.limits.calls:
            raise LimitError(f"{self._client.limits.calls} calls are under way")
        self._client.require(Operation.CALL, service.function)
        return service

    async def _answer(self, request: ServiceRequest, service: RobotService) -> None:
        try:
            reply = await self._backend.call(
                service.function,
                request.payload,
                read_as(request.encoding, self._client.limits.budget),
                self._client.limits.call_seconds,
            )
            encoding, encode = service.reply.encoding, service.reply.write
            if request.encoding == JSON:
                encoding, encode = JSON, TEXT_FORM.write
            payload = await self._backend.in_worker(lambda: encode(reply))
        except Exception as error:  # noqa: BLE001 - answered as the call's
            self._call_failed(request, error)
            return
        frame = service_response(request, encoding, payload)
        await self._client.outbox.room(len(frame))
        self._client.outbox.reply(frame, text=False)

    def _call_failed(self, request: ServiceRequest, error: BaseException) -> None:
        failure = {
            "serviceId": request.service,
            "callId": request.call,
            "message": self._shown(coded_text(error)),
        }
        self._client.outbox.reply(write("serviceCallFailure", **failure), text=True)

    def _warn(self, topic: str, text: str) -> None:
        self._status(StatusLevel.WARNING, f"{topic} {text}", topic)

    def _fail(self, error: BaseException, place: str = "") -> None:
        self._status(StatusLevel.ERROR, f"{place}{coded_text(error)}", "")

    def _status(self, level: StatusLevel, text: str, asked: str) -> None:
        self._client.outbox.reply(self._written_status(level, text, asked), text=True)

    def _written_status(self, level: StatusLevel, text: str, asked: str) -> bytes:
        return write("status", level=level.value, message=self._shown(text, asked))

    def _shown(self, text: str, asked: str = "") -> str:
        """Return a text with no name that the client may not see, but for what it asked for."""
        return self._backend.role_views.of(self._client.role).text(text, asked)


def _names_in(fields: Fields) -> list[str]:
    return [text_of({"name": name}, "name") for name in list_of(fields, "parameterNames", str)]


def _start(backend: Backend) -> MakeSession:
    return functools.partial(FoxgloveSession, backend=backend, catalogue=ChannelCatalogue(backend))


@hookimpl
def uoarm_front_ends() -> list[FrontEnd]:
    """Return the front end of this plugin."""
    return [
        FrontEnd(
            name="foxglove",
            summary="the Foxglove WebSocket protocol, for viewers",
            path="/foxglove",
            start=_start,
            # The second is what viewers asked for before; each refuses a server without its own.
            subprotocols=("foxglove.sdk.v1", "foxglove.websocket.v1"),
            contract=1,
        )
    ]
