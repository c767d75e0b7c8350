"""Displays that answer, refuse, stay silent, or are none."""

import os
import signal
import socket
import struct
import sys
import threading

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.helpers.displays import titles, wayland_compositor, x_server
from tests.helpers.live_frames import frames, known_fuser, numbers_in, session
from tests.helpers.machine import need_viewer
from tests.helpers.waiting import eventually
from viewer_app.errors import UsageError
from viewer_app.viewer import display
from viewer_app.viewer import window as window_module
from viewer_app.viewer.hub import Hub
from viewer_app.viewer.rerun_process import stop
from viewer_app.viewer.window import ViewerWindow, start_viewer

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="X and Wayland are displays of Linux")


@pytest.fixture(autouse=True)
def environment(monkeypatch, tmp_path):
    """An environment without a display."""
    monkeypatch.setenv("HOME", str(tmp_path / "home"))
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path / "run"))
    (tmp_path / "run").mkdir()
    monkeypatch.setattr(display, "_silent_since", {})
    return monkeypatch


def test_a_real_x_server_says_yes(environment):
    with x_server() as name:
        environment.setenv("DISPLAY", name)
        assert display.why_no_x() is None
        assert display.has_display()
    assert "does not answer" in display.why_no_x()


def test_a_real_wayland_compositor_says_yes(environment, tmp_path):
    with wayland_compositor(tmp_path / "run") as name:
        environment.setenv("WAYLAND_DISPLAY", name)
        assert display.has_display()
        assert display.environment_of_window()["WAYLAND_DISPLAY"] == name
        assert display.why_no_x() is not None, "a depth engine needs X"
        environment.setenv("WAYLAND_DISPLAY", str(tmp_path / "run" / name))
        assert display.has_display()
    assert f"{name} (environment variable WAYLAND_DISPLAY) does not answer" in display.why_no_window()


def test_a_window_opens_on_x_where_the_wayland_compositor_is_gone(environment):
    environment.setenv("WAYLAND_DISPLAY", "wayland-gone")
    assert not display.has_display()
    with x_server() as name:
        environment.setenv("DISPLAY", name)
        assert display.has_display()
        assert "WAYLAND_DISPLAY" not in display.environment_of_window()


class Gateway(threading.Thread):
    """A gateway to an X server, as ssh is one: it passes on what a client sends, and the first answer."""

    def __init__(self, name, opens=lambda set_up: True):
        super().__init__(daemon=True)
        self._server, self._opens = f"/tmp/.X11-unix/X{name[1:]}", opens
        self.answers = []  # the first byte of each
        self._listener = socket.create_server(("127.0.0.1", 0))
        self.start()

    @property
    def number(self):
        return self._listener.getsockname()[1] - 6000

    def run(self):
        with self._listener:
            while True:
                client, _ = self._listener.accept()
                with client, socket.socket(socket.AF_UNIX) as server:
                    set_up = client.recv(4096)
                    if not self._opens(set_up):
                        continue
                    server.connect(self._server)
                    server.sendall(set_up)
                    self.answers.append(server.recv(1))
                    client.sendall(self.answers[-1])


LOCAL, KIND = 256, b"MIT-MAGIC-COOKIE-1"  # of the addresses, of the cookies
HERE = socket.gethostname().encode()


def write_cookies(path, *entries):
    packed = b""
    for address, number, cookie in entries:
        fields = address, number, KIND, cookie
        packed += struct.pack(">H", LOCAL) + b"".join(struct.pack(">H", len(f)) + f for f in fields)
    path.write_bytes(packed)


def test_a_gateway_that_wants_this_machines_cookie_is_passed(environment, tmp_path):
    """ssh closes the connection of a client that shows it another."""
    right, wrong, users = b"c" * 16, b"w" * 16, tmp_path / "users"
    write_cookies(tmp_path / "server", (HERE, b"", right))
    with x_server("-auth", str(tmp_path / "server")) as name:
        gateway = Gateway(name, opens=lambda set_up: right in set_up)
        number = str(gateway.number).encode()
        environment.setenv("DISPLAY", f"localhost:{gateway.number}.0")
        assert not display.has_display()
        environment.setenv("XAUTHORITY", str(users))
        write_cookies(users, (b"elsewhere", number, wrong), (HERE, b"1", wrong), (HERE, number, right))
        assert display.has_display()
        assert gateway.answers == [b"\1"], "the server accepts it"


def test_a_refusal_is_an_answer(environment, tmp_path):
    """Rerun's viewer knows more kinds of authorisation."""
    write_cookies(tmp_path / "server", (HERE, b"", b"c" * 16))
    with x_server("-auth", str(tmp_path / "server")) as name:
        gateway = Gateway(name)
        environment.setenv("DISPLAY", f"127.0.0.1:{gateway.number}")
        assert display.has_display()
        assert gateway.answers == [b"\0"]


@pytest.mark.parametrize("variable", ["DISPLAY", "WAYLAND_DISPLAY"])
def test_a_silent_display_counts_as_none_and_is_waited_for_once(variable, environment, tmp_path):
    environment.setattr(display, "_ANSWERS_WITHIN", 0.2)
    if variable == "DISPLAY":
        silent = socket.create_server(("127.0.0.1", 0))
        name = f"127.0.0.1:{silent.getsockname()[1] - 6000}.0"
    else:
        silent, name = socket.socket(socket.AF_UNIX), "silent"
        silent.bind(str(tmp_path / "run" / name))
        silent.listen()
    with silent:
        environment.setenv(variable, name)
        words = display.why_no_window()
        assert f"{name} (environment variable {variable}) does not answer within 0.2 s" in words
        assert display.why_no_window() == words
        silent.accept()[0].close()
        silent.setblocking(False)
        with pytest.raises(BlockingIOError):
            silent.accept()


def test_a_display_that_was_silent_is_asked_again_later(environment):
    environment.setattr(display, "_ANSWERS_WITHIN", 0.2)
    with socket.create_server(("127.0.0.1", 0)) as server:
        environment.setenv("DISPLAY", f"127.0.0.1:{server.getsockname()[1] - 6000}")
        assert not display.has_display()
        environment.setattr(display, "_SILENCE_HOLDS", 0.0)
        environment.setattr(display, "_ANSWERS_WITHIN", 60.0)

        def answer():
            server.accept()[0].close()  # the silent one
            with server.accept()[0] as client:
                client.sendall(b"\1")

        threading.Thread(target=answer).start()
        assert display.has_display()


def test_no_display_is_named():
    assert display.why_no_window() == "There is no display for the viewer's window"


HOSTS = st.sampled_from(
    ["", "unix", "[::1]", "a..b", "\udcff", "x" * 64, "unix/", "tcp/127.0.0.1", "127.0.0.1"]
)
NAMES = st.builds("{}:{}".format, HOSTS, st.integers(40_000, 1_000_000)) | st.text(
    st.characters(codec="utf-8", exclude_characters="\0:")
)


@given(variable=st.sampled_from(["DISPLAY", "WAYLAND_DISPLAY"]), name=NAMES, damaged=st.binary())
def test_no_name_and_no_file_of_cookies_raises(variable, name, damaged, tmp_path_factory):
    folder = tmp_path_factory.getbasetemp()
    (folder / "cookies").write_bytes(damaged)
    raised = []
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("threading.excepthook", raised.append)
        for each, value in {
            "XAUTHORITY": folder / "cookies",
            "XDG_RUNTIME_DIR": folder,
            variable: name,
        }.items():
            patch.setitem(os.environ, each, str(value))
        why_not = display.why_no_window()
        assert why_not is None or name in why_not or name == ""
    assert raised == []


# --- Windows on a real X server that open, and that cannot.


@pytest.fixture
def screen(monkeypatch):
    """A real X server, as the display of this process."""
    need_viewer()
    with x_server() as name:
        monkeypatch.setenv("DISPLAY", name)
        yield name


def without_driver(monkeypatch):
    monkeypatch.setenv("VK_DRIVER_FILES", os.devnull)


def test_a_window_that_is_started_is_on_the_screen_and_opens_again(screen):
    window = ViewerWindow(lambda: start_viewer([]))
    try:
        assert titles(screen) == ["Rerun"]
        os.kill(window.process.pid, signal.SIGKILL)
        assert eventually(lambda: window.starts == 2)
        assert titles(screen) == ["Rerun"]
        assert window.failure == ""
    finally:
        window.leave()
        stop(window.process)


def test_a_viewer_that_hangs_while_it_opens_is_started_once_more(screen, monkeypatch):
    """As graphics drivers make it: it listens, and neither answers nor computes."""
    listens, hung = window_module.listens, []

    def listens_and_hangs(process, ports):
        found = listens(process, ports)
        if not hung:
            hung.append(process)
            os.kill(process.pid, signal.SIGSTOP)
        return found

    monkeypatch.setattr(window_module, "listens", listens_and_hangs)
    monkeypatch.setattr(window_module, "_HANGS_AFTER", 1.0)
    viewer, _ = start_viewer([])
    try:
        assert hung[0].poll() is not None
        assert viewer.poll() is None
        assert titles(screen) == ["Rerun"]
    finally:
        stop(viewer)


@pytest.mark.usefixtures("screen")
def test_a_viewer_that_cannot_draw_says_why(monkeypatch):
    without_driver(monkeypatch)
    with pytest.raises(UsageError, match=r"viewer does not start here \(.*graphics driver.*\)\. Use --save"):
        start_viewer([])


@pytest.mark.usefixtures("screen")
def test_a_window_that_does_not_open_again_is_given_up(monkeypatch):
    window = ViewerWindow(lambda: start_viewer([]))
    without_driver(monkeypatch)
    os.kill(window.process.pid, signal.SIGKILL)
    assert eventually(lambda: window.failure, 60.0)
    assert "graphics driver" in window.failure
    assert window.starts == 1


@pytest.mark.usefixtures("screen")
def test_a_session_is_saved_where_no_window_opens(monkeypatch, tmp_path):
    without_driver(monkeypatch)
    fuser, hub = known_fuser(), Hub.on_free_ports(web=False)
    with session(fuser, tmp_path / "s.rrd", hub, window=True, headless=False) as live:
        assert "graphics driver" in live.viewer.window_failure
        for frame in frames(fuser, 5):
            live.write(frame)
        live.finish()
        live.save()
    assert numbers_in(tmp_path / "s.rrd") == list(range(5))
    with pytest.raises(UsageError, match="graphics driver"), session(fuser, None, hub, True, headless=False):
        pass
