"""A WebSocket server: the JSON of :mod:`viewer_app.outputs.skeleton_json` for browsers and scripts.

The same port serves a page that shows the skeleton and what the set-up lacks, large enough to be read on a
phone from where the person stands. Each client has a slot for the newest frame, and a ping follows each
frame: a slow client skips frames, because no more may be unanswered than it takes within 0.3 s, and a blocked
one is disconnected. Who has the page's token may ask to save a session. Other messages of clients are counted
and ignored.
"""

from __future__ import annotations

import asyncio
import hmac
import ipaddress
import json
import logging
import secrets
import sys
import threading
from collections import deque
from collections.abc import Awaitable
from contextlib import suppress
from http import HTTPStatus
from importlib import resources
from typing import TYPE_CHECKING
from urllib.parse import urlsplit

from devices.events import Event
from fusion.setup import FusionSetup
from recordings.appearance.coach_page import CoachPage
from recordings.appearance.colors import MARK_COLORS, PREDICTED_COLOR, SKELETON_COLORS
from recordings.appearance.state_card import LOOKS, TONES
from recordings.data.session_arrays import SessionFrame
from viewer_app.addresses import LOOPBACK, in_url, is_loopback, reached_at
from viewer_app.errors import UsageError
from viewer_app.outputs.output import LATE_NS, LiveOutput
from viewer_app.outputs.skeleton_json import SkeletonJson
from viewer_app.sinks.item_queue import QueuedFrame
from viewer_app.sinks.requested_files import Saving

if TYPE_CHECKING:
    from websockets.asyncio.server import Server, ServerConnection
    from websockets.http11 import Request, Response

_LARGEST = 4096  # bytes of a client's message
_MOST_OPEN = 40
"""Maximum number of connections; at most a quarter of the files that the process may open."""
_AT_ONCE, _WAITING = 4, 100  # connections that are accepted before any of them is counted; and before that
_PATIENCE = 10.0  # seconds without an answer to a ping
_OPENS_WITHIN = 10.0
UNANSWERED = 4
"""Maximum number of frames on the way to a client, 0.13 s at 30 fps: buffers of the network hold seconds."""
_BEHIND_S = 0.3
_MOST_EVENTS = 64
_SECURITY = (
    "default-src 'none'; script-src 'unsafe-inline'; style-src 'unsafe-inline'; connect-src 'self' ws:"
)


class _Client:
    """What waits for one client: what is new of what holds, the newest frame and when it was made, events."""

    def __init__(self, holds: dict[str, str]) -> None:
        self.news = dict(holds)
        self.frame: tuple[str, int] | None = None
        self.events: deque[tuple[Event, int]] = deque()
        self.more = asyncio.Event()

    def add(self, event: Event) -> None:
        """Adds an event; where many wait, it stands for one that said the same, too, or for the oldest."""
        count = 1
        if len(self.events) >= _MOST_EVENTS:
            said = [(other.level, other.text) for other, _ in self.events]
            alike = said.index((event.level, event.text)) if (event.level, event.text) in said else 0
            count += self.events[alike][1]
            del self.events[alike]
        self.events.append((event, count))


def most_on_the_way(sent: int, seconds: float) -> int:
    """How many frames may be on the way to a client: as many as it takes within 0.3 s, at least one.

    Args:
        sent: How many were on the way with the one that it answered.
        seconds: How long it took to answer that one.
    """
    return min(max(int(_BEHIND_S * sent / max(seconds, 1e-3)), 1), UNANSWERED)


class WebSocketOutput(LiveOutput):
    """Serves S* on a port.

    Args:
        listen: Address of this machine to listen on; None for this machine only.
    """

    def __init__(self, port: int, setup: FusionSetup, listen: str | None = None) -> None:
        self.host = listen or LOOPBACK
        super().__init__(f"WebSocket on ws://{in_url(self.host)}:{port}")
        self.page = f"http://{reached_at(self.host)}:{port}"
        if not is_loopback(self.host):
            self.note = f"Anyone who can reach {self.host}:{port} can read the skeleton, without a password."
        self._json = SkeletonJson(setup)
        self._holds = {"hello": self._json.hello(setup)}  # messages by their type
        self._page = _page()
        self._token = ""
        self._request: deque[bool] = deque(maxlen=1)  # the newest
        self._clients: set[_Client] = set()
        self._open: dict[ServerConnection, None] = {}  # in order
        self._most_open = _most_open()
        self._most_clients = self._most_open * 4 // 5
        self.refused = 0
        """Connections that were closed because there were too many."""
        self.ignored = 0
        """Messages of clients."""
        self._loop = asyncio.new_event_loop()
        self._serving = threading.Thread(target=self._loop.run_forever, name="websocket", daemon=True)
        self._serving.start()
        try:
            self._server = asyncio.run_coroutine_threadsafe(self._serve(port), self._loop).result()
        except (OSError, OverflowError) as fault:
            self._end_loop()
            reason = getattr(fault, "strerror", None) or fault
            raise UsageError(
                f"--websocket {port}: cannot listen on {self.host}:{port} ({reason})."
            ) from fault
        self.start()

    def figures(self) -> dict[str, object]:
        return {**super().figures(), "ignored_messages": self.ignored, "refused": self.refused}

    def write(self, frame: SessionFrame) -> None:
        """Takes a frame, if there is a client."""
        if self._clients or self._start_ns is None:
            super().write(frame)
        else:
            self._number += 1

    def send_frame(self, frame: QueuedFrame) -> int | None:
        """Encodes a frame, if there is a client, and hands it to the server's thread."""
        if self._clients:
            self._publish(self._json.frame(frame), frame.written_ns)
            for event in self._json.gait_events():
                self._publish(event)
        return None  # the server's thread counts

    def send_event(self, event: Event) -> None:
        self._publish(event)

    def send_setup(self, setup: FusionSetup) -> None:
        """Sends the description again."""
        self._loop.call_soon_threadsafe(self._change, "hello", self._json.hello(setup))

    def allow_requests(self) -> None:
        """Gives the page a token with which it may ask for session files."""
        self._token, self.requests = secrets.token_urlsafe(9), self
        self.page = f"{self.page}/#{self._token}"

    def take_request(self) -> bool | None:
        """Whether to save, as the page asked for since the last call; None if it did not."""
        return self._request.pop() if self._request else None

    def tell_saving(self, state: Saving, text: str) -> None:
        """Sends what becomes of a session file; from any thread."""
        with suppress(RuntimeError):  # the server is closed
            self._loop.call_soon_threadsafe(self._change, "saving", self._json.saving(state, text))

    def coach(self, page: CoachPage) -> None:
        """Sends the state of the set-up and the next step."""
        self._loop.call_soon_threadsafe(self._change, "coach", self._json.coach(page))

    def shut(self) -> None:
        with suppress(TimeoutError):
            asyncio.run_coroutine_threadsafe(self._stop(), self._loop).result(2.0)
        self._end_loop()

    def _publish(self, said: str | Event, written_ns: int = 0) -> None:
        self._loop.call_soon_threadsafe(self._offer, said, written_ns)

    def _change(self, kind: str, said: str) -> None:
        self._holds[kind] = said
        for client in self._clients:
            client.news[kind] = said
            client.more.set()

    def _offer(self, said: str | Event, written_ns: int) -> None:
        for client in self._clients:
            if isinstance(said, Event):
                client.add(said)
            else:
                if client.frame is not None:
                    self._unsent(1)
                client.frame = said, written_ns
            client.more.set()

    def _add(self, connection: ServerConnection) -> None:
        """Makes room for a connection: the one that has been silent for longest goes.

        So a client that says at once what it wants is served, however many others say nothing.
        """
        from websockets.protocol import State

        self._open[connection] = None
        if len(self._open) > self._most_open:
            silent = next((each for each in self._open if each.state is State.CONNECTING), connection)
            del self._open[silent]
            silent.transport.abort()
            self.refused += 1
            self.warning = (
                f"{self.name}: {self.refused} connections were refused; {self._most_open} may be open."
            )

    async def _serve(self, port: int) -> Server:
        from websockets.asyncio.server import ServerConnection, serve

        output = self

        class Connection(ServerConnection):
            def connection_made(self, transport: asyncio.BaseTransport) -> None:
                super().connection_made(transport)
                output._add(self)

            def connection_lost(self, fault: Exception | None) -> None:
                output._open.pop(self, None)
                super().connection_lost(fault)

        # a client that speaks no WebSocket is not worth a traceback, one that is gone not a line for each
        # answer to its pings, and each connection no line where the process has no file left, which ends
        logging.getLogger("asyncio").addFilter(_is_worth_a_line)
        logger = logging.Logger("duplex.websocket", logging.CRITICAL + 1)
        server = await serve(
            self._attend,
            self.host,
            port,
            process_request=self._answer,
            compression=None,
            max_size=_LARGEST,
            max_queue=4,
            open_timeout=_OPENS_WITHIN,
            ping_interval=_PATIENCE,
            ping_timeout=_PATIENCE,
            close_timeout=1.0,
            server_header=None,
            logger=logger,
            create_connection=Connection,
            backlog=_AT_ONCE,
        )
        for listening in server.sockets:  # the system keeps more waiting than are accepted at once
            with listening.dup() as same:
                same.listen(_WAITING)
        return server

    def _answer(self, connection: ServerConnection, request: Request) -> Response | None:
        """Serves the page; refuses pages of other sites, which any browser would let in."""
        try:
            origin, host = request.headers.get("Origin"), request.headers.get("Host", "")
        except LookupError:
            return connection.respond(HTTPStatus.BAD_REQUEST, "Two hosts or two origins.\n")
        try:
            trusted = self._trusts(host, origin)
        except ValueError:  # no address at all
            trusted = False
        if not trusted:
            return connection.respond(HTTPStatus.FORBIDDEN, "This site may not read the skeleton.\n")
        if "websocket" in ",".join(request.headers.get_all("Upgrade")).lower():
            if len(self._clients) >= self._most_clients:
                return connection.respond(HTTPStatus.SERVICE_UNAVAILABLE, "Too many clients.\n")
            return None
        if urlsplit(request.path).path != "/":
            return connection.respond(HTTPStatus.NOT_FOUND, "Only / is here.\n")
        response = connection.respond(HTTPStatus.OK, "")
        response.body = self._page
        for name, value in (
            ("Content-Length", str(len(self._page))),
            ("Content-Type", "text/html; charset=utf-8"),
        ):
            del response.headers[name]
            response.headers[name] = value
        response.headers["Content-Security-Policy"] = _SECURITY
        return response

    def _trusts(self, host: str, origin: str | None) -> bool:
        """Programs, which send no origin, and pages of this machine or of this server.

        A name that an attacker's DNS turns to this machine must not count as this server. So a page of this
        server must have been opened under an address or under a name of the local network.
        """
        local = is_loopback(self.host)
        named = urlsplit(f"//{host}").hostname
        if local and not is_loopback(named):
            return False
        if origin is None:
            return True
        parts = urlsplit(origin)
        return is_loopback(parts.hostname) or (
            not local and parts.netloc == host and _is_of_local_network(named)
        )

    async def _attend(self, connection: ServerConnection) -> None:
        from websockets.exceptions import ConnectionClosed

        client = _Client(self._holds)
        self._clients.add(client)
        sending = asyncio.create_task(self._feed(connection, client))
        try:
            async for message in connection:
                self.ignored += not self._takes(message, client)
        except ConnectionClosed:
            pass
        finally:
            self._clients.discard(client)
            sending.cancel()

    def _takes(self, message: str | bytes, client: _Client) -> bool:
        """Takes a request, or tells whether the client has the token; whether it has it and asks so."""
        try:
            said = json.loads(message)
        except (ValueError, RecursionError):
            return False
        if not self._token or not isinstance(said, dict) or said.get("type") != "save" or "on" not in said:
            return False
        given = str(said.get("token")).encode(errors="replace")
        may = hmac.compare_digest(given, self._token.encode())
        if said["on"] is None:
            client.news["may_save"] = self._json.may_save(may)
            client.more.set()
        elif may and isinstance(said["on"], bool):
            self._request.append(said["on"])
        return may and isinstance(said["on"], bool | None)

    async def _feed(self, connection: ServerConnection, client: _Client) -> None:
        from websockets.exceptions import ConnectionClosed

        unanswered: deque[tuple[int, Awaitable[float]]] = deque()
        most = 1
        with suppress(ConnectionClosed):
            await _send_news(connection, client)
            while True:
                await client.more.wait()
                while len(unanswered) >= most:
                    sent, answered = unanswered.popleft()
                    most = most_on_the_way(sent, await answered)
                client.more.clear()
                await _send_news(connection, client)
                while client.events:
                    await connection.send(self._json.event(*client.events.popleft()))
                if client.frame is not None:
                    (text, written_ns), client.frame = client.frame, None
                    await connection.send(text)
                    self._sent += 1
                    self._late += self._clock() - written_ns > LATE_NS
                unanswered.append((len(unanswered) + 1, await connection.ping()))

    async def _stop(self) -> None:
        self._server.close()
        await self._server.wait_closed()

    def _end_loop(self) -> None:
        self._loop.call_soon_threadsafe(self._loop.stop)
        self._serving.join(2.0)
        if not self._serving.is_alive():
            self._loop.close()


async def _send_news(connection: ServerConnection, client: _Client) -> None:
    while client.news:
        await connection.send(client.news.pop(next(iter(client.news))))


def _page() -> bytes:
    """The page, with the colours and sounds of the program."""
    template = resources.files("viewer_app.outputs").joinpath("templates/skeleton.html")
    colors = {**SKELETON_COLORS, **MARK_COLORS, "unsure": PREDICTED_COLOR}
    for state, look in LOOKS.items():
        colors |= {state.name: look.ground, f"{state.name}_ink": look.ink}
    variables = " ".join(f"--{name}: rgb{color};" for name, color in colors.items())
    text = template.read_text(encoding="utf-8")
    return text.replace("COLORS", variables).replace("SOUNDS", json.dumps(TONES)).encode()


def _is_worth_a_line(record: logging.LogRecord) -> bool:
    return not any(said in record.msg for said in ("socket.send() raised", "socket.accept() out of"))


def _most_open() -> int:
    if sys.platform == "win32":
        return _MOST_OPEN
    import resource

    files, _ = resource.getrlimit(resource.RLIMIT_NOFILE)
    return _MOST_OPEN if files == resource.RLIM_INFINITY else min(_MOST_OPEN, files // 4)


def _is_of_local_network(host: str | None) -> bool:
    """An IP address, or a name that no public DNS resolves: without a dot, or ending in .local."""
    if not host:
        return False
    try:
        ipaddress.ip_address(host)
    except ValueError:
        return "." not in host or host.endswith(".local")
    return True
