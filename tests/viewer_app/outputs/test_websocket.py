"""The WebSocket server, read by the ``websockets`` client and by a browser, and attacked by random data."""

import json
import socket
import struct
import time
from contextlib import ExitStack, closing
from dataclasses import replace
from urllib.error import HTTPError
from urllib.request import Request, urlopen

import numpy as np
import psutil
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation
from websockets.exceptions import ConnectionClosed, InvalidStatus
from websockets.sync.client import connect

from devices.events import Event
from fusion.body import KINECT_V2
from recordings.appearance.coach_page import CoachPage, Mark
from recordings.appearance.state_card import LOOKS, TONES, State
from tests.helpers.live_frames import frames
from tests.helpers.machine import need_browser
from tests.helpers.network import free_port
from tests.helpers.waiting import eventually
from viewer_app.addresses import reached_at
from viewer_app.errors import UsageError
from viewer_app.outputs import websocket
from viewer_app.outputs.output import confidence
from viewer_app.outputs.skeleton_json import SkeletonJson
from viewer_app.outputs.websocket import UNANSWERED, WebSocketOutput, most_on_the_way
from viewer_app.sinks.item_queue import QueuedFrame


@pytest.fixture
def server(fuser):
    output = WebSocketOutput(free_port(), fuser.setup)
    yield output
    output.close()


def port_of(server):
    return int(server.page.rpartition(":")[2])


def client_of(server, **how):
    return connect(f"ws://127.0.0.1:{port_of(server)}", open_timeout=30, **how)


def read(client):
    said = json.loads(client.recv(timeout=30))
    assert isinstance(said, dict)
    return said


def test_a_client_reads_the_description_then_frames_and_events(server, fuser):
    with client_of(server) as client:
        hello = read(client)
        assert (hello["type"], hello["schema"], hello["version"]) == ("hello", "duplex-kinects/skeleton", 2)
        assert (hello["joints"], hello["parents"]) == (list(KINECT_V2.joints), list(KINECT_V2.parents))
        lengths = np.array(hello["bone_lengths"])
        for number, frame in enumerate(frames(fuser, 10)):
            server.write(replace(frame, unix_ns=10**18 + frame.pair.time_ns))
            said = read(client)
            assert (said["type"], said["number"], said["person"]) == ("frame", number, True)
            assert said["unix_time_s"] == pytest.approx(1e9 + said["time_s"], abs=1e-5)
            assert said["time_s"] == pytest.approx(frame.pair.time_ns * 1e-9, abs=1e-6)
            at = np.array(said["positions"])
            np.testing.assert_allclose(at, frame.fused.positions, atol=0.5e-4 + 1e-9)  # four digits
            np.testing.assert_allclose(said["confidence"], confidence(frame.fused), atol=0.5e-3 + 1e-9)
            np.testing.assert_allclose(said["sigma"], frame.fused.sigma, atol=0.5e-4 + 1e-9)
            np.testing.assert_allclose(said["velocities"], frame.fused.velocities, atol=0.5e-3 + 1e-9)
            np.testing.assert_allclose(said["covariances"], frame.fused.covariance, atol=0.5e-8 + 1e-12)
            # rotations have five digits, bones at most 0.5 m, the tree has eight levels: 0.04 mm;
            # positions have four digits: 0.05 mm for the root and for the joint
            made = at[KINECT_V2.root] + np.zeros((25, 3))
            turns = Rotation.from_quat(said["rotations"])
            for j in KINECT_V2.order[1:]:
                rest = KINECT_V2.rest[j] * lengths[j]
                made[j] = made[KINECT_V2.parents[j]] + turns[int(j)].apply(rest)
            np.testing.assert_allclose(made, at, atol=1.4e-4)
        server.event(Event("B lost; use `depth=none`", "WARN"))
        event = read(client)
        assert (event["type"], event["level"]) == ("event", "WARN")
        assert event["text"] == "B lost; use --depth none"
        server.recalibrated(fuser.setup)
        assert read(client)["type"] == "hello"
        changed = read(client)
        assert (changed["type"], changed["text"]) == ("event", "calibration changed")
        assert changed["unix_time_s"] - changed["time_s"] == pytest.approx(
            said["unix_time_s"] - said["time_s"], abs=1e-5
        )
    assert server.counts.sent == 10


def test_what_a_method_or_a_session_does_not_know_is_null(fuser):
    encoder, frame = SkeletonJson(fuser.setup), frames(fuser, 1)[0]
    paper = replace(frame.fused, sigma=None, covariance=None, velocities=None)
    said = json.loads(encoder.frame(QueuedFrame(0, replace(frame, fused=paper), 0, 0)))
    for name in ("velocities", "covariances", "sigma", "unix_time_s"):
        assert said[name] is None
    assert said["positions"] is not None
    unknown = replace(frame.fused, covariance=np.full_like(frame.fused.covariance, np.inf))
    text = encoder.frame(QueuedFrame(1, replace(frame, fused=unknown), 0, 0))
    assert "Infinity" not in text  # no JSON


def test_an_empty_view_is_reported(server, fuser):
    frame = without_person(frames(fuser, 1)[0])
    with client_of(server) as client:
        read(client)
        server.write(frame)
        said = read(client)
    assert said["person"] is False
    assert said["positions"] is said["rotations"] is said["confidence"] is said["sigma"] is None


def without_person(frame):
    nowhere = np.full_like(frame.fused.positions, np.nan)
    return replace(frame, fused=replace(frame.fused, positions=nowhere))


def test_a_client_that_does_not_read_skips_frames_and_costs_others_nothing(server, fuser):
    made = frames(fuser, 1)[0]
    with socket.socket() as lazy:
        lazy.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)  # before connecting, or it has no effect
        lazy.connect(("127.0.0.1", port_of(server)))
        lazy.sendall(handshake(port_of(server)))
        assert eventually(lambda: len(server._clients) == 1)
        with client_of(server) as client:
            read(client)
            numbers = []
            slowest = 0.0
            for _ in range(300):  # 1.4 MB: more than both buffers of the lazy client
                before = time.perf_counter()
                server.write(made)
                slowest = max(slowest, time.perf_counter() - before)
                numbers.append(read(client)["number"])
            assert numbers == list(range(300))
            assert server.counts.dropped > 0
            assert slowest < 3.0  # a loop that waited would never return


def test_a_client_that_pings_and_resets_is_not_worth_a_line(server, caplog):
    """Python's event loop warns of each answer to a connection that is gone."""
    with socket.create_connection(("127.0.0.1", port_of(server))) as rude:
        rude.sendall(handshake(port_of(server)))
        assert eventually(lambda: len(server._clients) == 1)
        rude.sendall(b"\x89\x80\0\0\0\0" * 5000)
        rude.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
    assert eventually(lambda: not server._clients)
    with client_of(server) as client:  # the server goes on
        assert read(client)["type"] == "hello"
    assert caplog.records == []


class RawClient:
    """A client that answers pings when told to."""

    def __init__(self, server):
        self._socket = socket.create_connection(("127.0.0.1", port_of(server)))
        self._socket.settimeout(30.0)
        self._socket.sendall(handshake(port_of(server)))
        self._received = self._socket.makefile("rb")
        while self._received.readline().strip():
            pass
        assert eventually(lambda: len(server._clients) == 1)

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self._received.close()
        self._socket.close()

    def until_ping(self):
        """The messages before the next ping, and the content of this."""
        messages = []
        while True:
            kind, size = self._received.read(2)
            if size == 126:
                size = int.from_bytes(self._received.read(2), "big")
            content = self._received.read(size)
            if kind == 0x89:
                return messages, content
            messages.append(json.loads(content))

    def answer(self, ping):
        self._socket.sendall(b"\x8a\x84\0\0\0\0" + ping)


def are_sent(server, frame, count):
    """Whether so many frames are sent, and no more however many are made."""

    def sent():
        server.write(frame)
        return server.counts.sent >= count

    assert eventually(sent)
    dropped = server.counts.dropped
    for _ in range(30):
        server.write(frame)
    assert eventually(lambda: server.counts.dropped >= dropped + 29)  # the last one waits
    return server.counts.sent == count


@pytest.mark.parametrize(("behind_s", "on_the_way"), [(0.0, 1), (1e9, UNANSWERED)])
def test_a_client_gets_as_many_frames_ahead_as_its_answers_allow(
    server, fuser, monkeypatch, behind_s, on_the_way
):
    """Buffers of the network would take all frames, and the client would see the past: four frames that take
    two seconds each would show eight seconds ago."""
    monkeypatch.setattr(websocket, "_BEHIND_S", behind_s)
    frame = frames(fuser, 1)[0]
    with RawClient(server) as client:
        assert are_sent(server, frame, 1)
        client.answer(client.until_ping()[1])
        assert are_sent(server, frame, 1 + on_the_way)


@given(st.floats(1e-3, 10.0), st.integers(1, UNANSWERED))
def test_no_more_frames_are_on_the_way_than_a_client_takes_in_300_ms(seconds_each, sent):
    most = most_on_the_way(sent, sent * seconds_each)
    assert 1 <= most <= UNANSWERED
    assert most == 1 or most * seconds_each <= 0.3 + 1e-9
    assert most == UNANSWERED or (most + 1) * seconds_each > 0.3 - 1e-9


def test_events_for_a_slow_client_are_merged_and_none_is_lost(server, fuser):
    with RawClient(server) as client:
        assert are_sent(server, frames(fuser, 1)[0], 1)
        _, ping = client.until_ping()
        server.send_event(Event("sensor B lost", "WARN"))
        for k in range(3000):
            server.send_event(Event(f"heel strike {k % 3}", time_ns=k * 1_000_000_000))
        made, told = frames(fuser, 1)[0], []
        while sum(event.get("count", 1) for event in told) < 3001:
            client.answer(ping)
            server.write(made)
            messages, ping = client.until_ping()
            told += [message for message in messages if message["type"] == "event"]
    assert len(told) < 200
    assert sum(event.get("count", 1) for event in told) == 3001
    assert {event["text"] for event in told} == {"sensor B lost", *(f"heel strike {k}" for k in range(3))}
    assert [event["time_s"] for event in told[-3:]] == [2997.0, 2998.0, 2999.0]


def handshake(port):
    return (
        f"GET / HTTP/1.1\r\nHost: 127.0.0.1:{port}\r\nUpgrade: websocket\r\nConnection: Upgrade\r\n"
        "Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\nSec-WebSocket-Version: 13\r\n\r\n"
    ).encode()


def test_it_listens_on_this_machine_only_unless_told_otherwise(server):
    listening = {
        tuple(each.laddr)
        for each in psutil.Process().net_connections("inet")
        if each.status == psutil.CONN_LISTEN and each.laddr.port == port_of(server)
    }
    assert listening == {("127.0.0.1", port_of(server))}


def test_pages_of_other_sites_may_not_read(server, fuser):
    for origin in ("https://example.org", "null", f"http://example.org:{port_of(server)}", "http://[", "x"):
        with pytest.raises(InvalidStatus, match="403"), client_of(server, origin=origin):
            pass
    for origin in (f"http://localhost:{port_of(server)}", "http://127.0.0.1:5173"):
        with client_of(server, origin=origin) as client:
            assert read(client)["type"] == "hello"
    rebound = Request(server.page, headers={"Host": f"example.org:{port_of(server)}"})
    with pytest.raises(HTTPError, match="403"):
        urlopen(rebound, timeout=30)
    with pytest.raises(HTTPError, match="404"):
        urlopen(f"{server.page}/etc/passwd", timeout=30)
    with closing(WebSocketOutput(free_port(), fuser.setup, "0.0.0.0")) as open_to_all:
        port = port_of(open_to_all)
        assert open_to_all.page == f"http://{reached_at('0.0.0.0')}:{port}"
        for name, answer in (("rebound.example.org", b"403"), ("192.168.0.20", b"101"), ("pc.local", b"101")):
            with socket.create_connection(("127.0.0.1", port)) as raw:
                named = f"{name}:{port}\r\nOrigin: http://{name}:{port}"
                raw.sendall(handshake(port).replace(f"127.0.0.1:{port}".encode(), named.encode()))
                assert raw.recv(12) == b"HTTP/1.1 " + answer
        with socket.create_connection(("127.0.0.1", port)) as raw:
            named = f"lab-pc:{port}\r\nOrigin: http://lab-pc:{port}"
            raw.sendall(handshake(port).replace(f"127.0.0.1:{port}".encode(), named.encode()))
            assert raw.recv(12) == b"HTTP/1.1 101"
        with pytest.raises(InvalidStatus, match="403"):
            connect(f"ws://127.0.0.1:{port}", origin="http://example.org", open_timeout=30)


@pytest.mark.parametrize("twice", ["Host: 127.0.0.1", "Origin: http://localhost\r\nOrigin: http://localhost"])
def test_two_hosts_or_two_origins_are_a_bad_request(server, twice):
    port = port_of(server)
    with socket.create_connection(("127.0.0.1", port)) as raw:
        raw.sendall(handshake(port).replace(b"\r\n\r\n", f"\r\n{twice}\r\n\r\n".encode()))
        assert raw.recv(12) == b"HTTP/1.1 400"


def test_a_foreign_address_is_refused(fuser):
    with pytest.raises(UsageError, match=r"cannot listen on 192\.0\.2\.1"):
        WebSocketOutput(free_port(), fuser.setup, "192.0.2.1")


def test_a_client_too_many_is_refused_and_costs_the_others_nothing(server):
    server._most_clients = 2
    with client_of(server) as one, client_of(server) as two:
        for client in (one, two):
            assert read(client)["type"] == "hello"
        with pytest.raises(InvalidStatus, match="503"), client_of(server):
            pass
    assert eventually(lambda: not server._clients)
    with client_of(server) as client:
        assert read(client)["type"] == "hello"


def test_who_says_nothing_makes_room_for_who_does(server, fuser):
    """However many connect and say nothing, few are open, a client is served, and one line says it."""
    frame, most = frames(fuser, 1)[0], server._most_open
    with ExitStack() as stack:
        first = stack.enter_context(client_of(server))
        read(first)
        silent = [socket.create_connection(("127.0.0.1", port_of(server)), 30) for _ in range(150)]
        for one in silent[::2]:
            one.sendall(b"GET / HTTP/1.1\r\nHost:")
        for one in silent:
            stack.callback(one.close)
        assert eventually(lambda: server.refused == 151 - most)
        assert len(server._open) == most
        second = stack.enter_context(client_of(server))
        read(second)
        server.write(frame)
        assert [read(client)["number"] for client in (first, second)] == [0, 0]
        assert f"{server.refused} connections were refused; {most} may be open." in server.warning
    assert eventually(lambda: not server._open)


def test_text_that_clients_send_is_counted_and_ignored(server):
    with client_of(server) as client:
        read(client)
        for _ in range(50):
            client.send('{"type": "frame"}')
        client.send(b"\x80\x04.")  # a pickle
        assert eventually(lambda: server.ignored == 51)
    with client_of(server) as client:
        read(client)
        client.send("x" * 100_000)
        with pytest.raises(ConnectionClosed):
            client.recv(timeout=30)
    assert server.figures()["ignored_messages"] == 51


RING = Mark((((0.0, 1.0, 2.3), (0.3, 1.0, 2.6), (0.0, 1.0, 2.9)),), "do", (0.0, 1.5, 2.6))


def test_what_a_set_up_lacks_holds_for_later_clients_until_it_changes(server):
    for page in (
        CoachPage("text", (("spot", RING),), (State.NOT_YET, "stand in the ring")),
        CoachPage("text", (), (State.READY, "begin")),
        CoachPage("text"),  # no set-up
    ):
        server.coach(page)
        assert eventually(lambda page=page: server._holds.get("coach") == server._json.coach(page))
        with client_of(server) as client:
            hello, said = read(client), read(client)
        assert hello["sensors"][0] == [0.0, 0.0, 0.0]
        assert (said["type"], said["version"]) == ("coach", 2)
        state, step = page.card or (None, None)
        assert (said["state"], said["step"]) == (state and state.value, step)
        assert set(said["marks"]) == {name for name, _ in page.marks}
        for mark in said["marks"].values():
            assert (mark["words"], mark["meaning"]) == ("stand here", "do")
            np.testing.assert_allclose(mark["lines"], RING.lines)


def test_a_page_in_a_browser_draws_the_skeleton(server, fuser, tmp_path):
    playwright = pytest.importorskip("playwright.sync_api", reason="no playwright")
    chromium = need_browser()
    with playwright.sync_playwright() as p:
        browser = p.chromium.launch(executable_path=chromium, args=["--no-sandbox"])
        try:
            # The page forbids eval, which playwright uses for waiting.
            tab = browser.new_page(
                viewport={"width": 800, "height": 800}, color_scheme="light", bypass_csp=True
            )
            tab.add_init_script(_TONES_PLAYED)
            wrong = []
            tab.on("console", lambda message: wrong.append(message.text) if message.type == "error" else None)
            tab.on("pageerror", lambda error: wrong.append(str(error)))
            asked = []
            tab.on("request", lambda request: asked.append(request.url))
            tab.goto(server.page)
            tab.wait_for_function("skeleton.hello !== null")
            for frame in frames(fuser, 5):
                server.write(frame)
                tab.wait_for_function(
                    f"skeleton.frame && skeleton.frame.time_s >= {frame.pair.time_ns * 1e-9 - 1e-5}"
                )
            tab.wait_for_function("skeleton.drawn > 0")
            status = tab.locator("#status").inner_text()
            assert "kinect_v2" in status
            boxes = tab.evaluate(_INK)
            tab.screenshot(path=str(tmp_path / "page.png"))
            assert not tab.locator("#coach").is_visible()
            tab.locator("#sound").click()
            for state in State:
                server.coach(CoachPage("", (("spot", RING),), (state, f"step of {state.value}")))
                tab.wait_for_function(f"document.getElementById('state').textContent === '{state.value}'")
                assert tab.locator("#step").inner_text() == f"step of {state.value}"
                ground = tab.evaluate("getComputedStyle(document.getElementById('coach')).backgroundColor")
                assert ground == f"rgb{LOOKS[state].ground}"
            tones = [hertz for name in ("not yet", "ready") for hertz, _ in TONES[name]]
            assert tab.evaluate("hertz") == tones, "each new state once"
            server.coach(CoachPage(""))
            tab.wait_for_function("document.getElementById('coach').hidden")
            tab.wait_for_function("document.getElementById('age').textContent.endsWith(' s old')")
            tab.wait_for_function("document.getElementById('age').className === 'late'")
            server.event(Event("sensor B lost", "WARN"))
            tab.wait_for_function("document.getElementById('event').textContent.includes('sensor B lost')")
            server.write(without_person(frames(fuser, 1)[0]))
            tab.wait_for_function("document.getElementById('status').textContent.includes('nobody')")
            assert tab.evaluate(_INK)["count"] == 0
            assert [url for url in asked if not url.startswith(server.page)] == []
            assert [line for line in wrong if "favicon" not in line and "404" not in line] == []
        finally:
            browser.close()
    # 1.75 m seen from 20 degrees above, at 290 pixels per metre; arms 50 degrees apart are at least 200 wide
    assert boxes["height"] == pytest.approx(480, abs=80)
    assert 200 < boxes["width"] < 500
    assert 2000 < boxes["count"] < 60_000


_TONES_PLAYED = """
  window.hertz = [];
  const original = AudioContext.prototype.createOscillator;
  AudioContext.prototype.createOscillator = function () {
    const tone = original.call(this), start = tone.start.bind(tone);
    tone.start = when => { hertz.push(tone.frequency.value); start(when); };
    return tone;
  };
"""
_INK = """() => {
  const canvas = document.getElementById("view");
  const data = canvas.getContext("2d").getImageData(0, 0, canvas.width, canvas.height).data;
  let count = 0, left = 1e9, right = 0, top = 1e9, bottom = 0;
  for (let k = 3; k < data.length; k += 4) if (data[k] > 128) {
    const x = ((k - 3) / 4) % canvas.width, y = Math.floor((k - 3) / 4 / canvas.width);
    count += 1; left = Math.min(left, x); right = Math.max(right, x);
    top = Math.min(top, y); bottom = Math.max(bottom, y);
  }
  return { count, width: right - left, height: bottom - top };
}"""
