"""Outputs at the command line: ``demo``, ``live`` and ``replay --pace live``."""

import json
import socket
import sys

import numpy as np
import pytest

from devices.events import Event
from fusion.body import KINECT_V2
from tests.helpers.command_line import duplex, one_line
from tests.helpers.frame_pairs import frame_pairs
from tests.helpers.fused_runs import record_fused
from tests.helpers.live_frames import frames
from tests.helpers.network import free_port
from tests.helpers.two_views import FRAME_NS, calibration_of
from viewer_app.outputs.avatars.osc import Address, looked_up
from viewer_app.running.loop import played
from viewer_app.sinks.sink import Sink


@pytest.fixture
def receiver():
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as opened:
        opened.bind(("127.0.0.1", 0))
        opened.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 1 << 21)
        opened.settimeout(0.5)
        yield opened


def datagrams(receiver):
    count = 0
    try:
        while receiver.recv(2000).startswith(b"#bundle"):
            count += 1
    except TimeoutError:
        pass
    return count


def test_demo_sends_to_several_at_once_and_says_how_it_went(receiver, tmp_path, capsys):
    to, port = f"127.0.0.1:{receiver.getsockname()[1]}", free_port()
    options = ("--seconds", 2, "--depth", "none", "--no-viewer", "--save", tmp_path / "s.rrd")
    assert duplex("demo", *options, "--vmc", to, "--vrchat", to, "--websocket", port) == 0
    said = " ".join(capsys.readouterr().out.split())
    for name in (f"VMC to {to}", f"VRChat at {to}", f"WebSocket on ws://127.0.0.1:{port}"):
        assert f"Sending: {name}" in said
        assert f"{name}: " in said
    # 60 frames: two datagrams of VMC and one of VRChat each, unless a busy machine drops some
    assert 60 <= datagrams(receiver) <= 3 * 61


def test_replay_sends_at_the_recorded_times(receiver, tmp_path, capsys):
    session = record_fused(tmp_path / "s.rrd", frame_pairs(KINECT_V2, 30), calibration_of(KINECT_V2))
    to = f"127.0.0.1:{receiver.getsockname()[1]}"
    report = tmp_path / "r.json"
    assert (
        duplex("replay", session.path, "--pace", "live", "--vmc", to, "--no-viewer", "--report", report) == 0
    )
    figures = json.loads(report.read_text(encoding="utf-8"))["outputs"]
    assert [each["to"] for each in figures] == [f"VMC to {to}"]
    assert figures[0]["sent"] + figures[0]["dropped"] == 30
    assert datagrams(receiver) >= figures[0]["sent"]
    assert "frames sent" in capsys.readouterr().out


class Notebook(Sink):
    def __init__(self):
        self.now = 10.0
        self.at = []
        self.said = []

    def write(self, frame):
        del frame
        self.at.append(self.now)

    def event(self, event):
        self.said.append((len(self.at) - 1, event.text))

    def wait(self, seconds):
        self.now += seconds


def test_each_frame_is_played_when_it_is_due_and_events_with_theirs(fuser):
    book = Notebook()
    made = frames(fuser, 20)
    events = [Event("first", "INFO"), Event("later", "WARN").placed(7, 7 * FRAME_NS)]

    def slow():
        for k, frame in enumerate(made):
            book.now += 0.5 if k == 10 else 0.001  # fusing takes a millisecond, once half a second
            yield frame

    yielded = list(played(slow(), book, {}, events, clock=lambda: book.now, wait=book.wait))
    assert yielded == made
    due = book.at[0] + np.arange(20) * FRAME_NS * 1e-9
    np.testing.assert_allclose(book.at[:10], due[:10], atol=1e-9)
    np.testing.assert_allclose(
        book.at[10:], np.maximum(due[10:], due[9] + 0.5 + 0.001 * np.arange(10)), atol=1e-6
    )
    assert book.said == [(0, "first"), (7, "later")]


def test_a_name_with_addresses_of_both_kinds_is_that_of_ipv4(monkeypatch):
    """Receivers of VMC and OSC listen there."""
    both = [
        (socket.AF_INET6, socket.SOCK_DGRAM, 17, "", ("::1", 39539, 0, 0)),
        (socket.AF_INET, socket.SOCK_DGRAM, 17, "", ("127.0.0.1", 39539)),
    ]
    for found in (both, both[::-1]):
        monkeypatch.setattr(socket, "getaddrinfo", lambda *_, found=found, **__: found)
        assert looked_up(Address("localhost", 39539), "--vmc") == (socket.AF_INET, ("127.0.0.1", 39539))
    monkeypatch.setattr(socket, "getaddrinfo", lambda *_, **__: both[:1])
    assert looked_up(Address("::1", 39539), "--vmc")[0] == socket.AF_INET6


def test_a_port_in_use_gives_one_line_and_opens_nothing(capsys):
    with socket.socket() as other:
        other.bind(("127.0.0.1", 0))
        other.listen()
        port = other.getsockname()[1]
        assert duplex("demo", "--no-viewer", "--depth", "none", "--vmc", 39539, "--websocket", port) == 2
    assert f"--websocket {port}: cannot listen" in one_line(capsys)


@pytest.mark.parametrize(("option", "package"), [("lsl", "pylsl"), ("zenoh", "zenoh")])
def test_a_missing_extra_is_named(option, package, monkeypatch, capsys):
    monkeypatch.setitem(sys.modules, package, None)
    assert duplex("demo", "--no-viewer", f"--{option}", "name") == 2
    assert f'pip install "duplex-kinects[{option}]"' in one_line(capsys)
