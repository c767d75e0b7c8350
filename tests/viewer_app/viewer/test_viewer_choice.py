"""A session in a browser, and the addresses that can reach it."""

import io
import lzma
import os
import socket
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from types import SimpleNamespace
from urllib.request import Request, urlopen

import cv2
import numpy as np
import psutil
import pytest
import rerun as rr
import rerun.blueprint as rrb
from rich.console import Console

from recordings import Session
from recordings.appearance.coach_page import CoachPage
from recordings.data import layout
from recordings.file.rrd_file import damage_of
from recordings.file.session_writer import whole_recording
from tests.helpers.live_frames import frames, session
from tests.helpers.machine import lacks, need_viewer
from tests.helpers.recorded_pairs import write_pair
from tests.helpers.waiting import eventually
from viewer_app.addresses import LOOPBACK, reached_at
from viewer_app.errors import UsageError
from viewer_app.options.shared import ViewerOptions
from viewer_app.outputs.opening import announce_outputs
from viewer_app.viewer import file_window, window
from viewer_app.viewer import hub as hub_module
from viewer_app.viewer.blueprint import SCENE
from viewer_app.viewer.hub import DATA_PORT, PAGE_PORT, Hub, free_port
from viewer_app.viewer.rerun_process import stop
from viewer_app.viewer.viewer_choice import NoViewer, WebPage, choose_viewing
from viewer_app.viewer.window import start_viewer


def web_hub(address=LOOPBACK):
    """A hub on any ports: other tests run beside."""
    return Hub(free_port(address), free_port(address), address)


@pytest.fixture
def served(fuser):
    """A session that is served to browsers."""
    with session(fuser, None, web_hub(), active="setup") as live:
        yield live


def sockets(pid):
    """What a process and its children listen on."""
    process = psutil.Process(pid)
    everyone = [process, *process.children(recursive=True)]
    return [c.laddr for p in everyone for c in p.net_connections("inet") if c.status == psutil.CONN_LISTEN]


def listening(pid):
    """The addresses that a process and its children listen on."""
    return {socket.ip for socket in sockets(pid)}


def ports_of(pid):
    """The ports that a process and its children listen on."""
    return {socket.port for socket in sockets(pid)}


def test_hub_page_and_window_listen_on_loopback_only(served):
    assert listening(served.viewer.process.pid) == {"127.0.0.1"}
    own = {c.laddr.ip for c in psutil.Process().net_connections("inet") if c.status == psutil.CONN_LISTEN}
    assert own <= {"127.0.0.1"}


def test_a_viewer_that_we_start_listens_on_loopback_only():
    need_viewer()
    viewer, _ = start_viewer(["--headless"])
    try:
        assert listening(viewer.pid) == {"127.0.0.1"}
    finally:
        stop(viewer)


def test_an_address_that_is_asked_for_is_listened_on(fuser):
    with session(fuser, None, web_hub("0.0.0.0")) as live:
        assert listening(live.viewer.process.pid) == {"0.0.0.0"}


def test_usage_statistics_are_off(served):
    assert psutil.Process(served.viewer.process.pid).environ()["RERUN_ANALYTICS"] == "0"


def test_the_page_is_the_viewer_with_the_session(served):
    hub = served.viewer.hub
    with urlopen(hub.page, timeout=5.0) as page:
        assert b"<canvas" in page.read()
    assert f":{hub.port}/proxy" in hub.page


def said(viewing, monkeypatch):
    monkeypatch.setattr("viewer_app.viewer.web_page.has_display", lambda: False)
    out = io.StringIO()
    viewing.announce(Console(file=out, width=300))
    return out.getvalue()


def test_listening_to_others_is_warned_of(monkeypatch):
    alone, open_to_all = (
        said(WebPage(hub=web_hub(address)), monkeypatch) for address in (LOOPBACK, "0.0.0.0")
    )
    assert "Warning" not in alone
    assert "http://127.0.0.1:" in alone
    assert "Warning" in open_to_all
    assert "video included" in open_to_all
    assert said(NoViewer(), monkeypatch) == ""


def announced_session(address, console):
    hub = Hub(DATA_PORT, PAGE_PORT, address)
    WebPage(hub=hub).announce(console)
    return hub.page


def announced_output(address, console):
    page = f"http://{reached_at(address)}:8765"
    announce_outputs(console, [SimpleNamespace(name="WebSocket", page=page, note="")])
    return page


@pytest.mark.parametrize("announced", [announced_session, announced_output])
def test_a_terminal_shows_the_address_for_a_camera(monkeypatch, announced):
    monkeypatch.setattr("viewer_app.viewer.web_page.has_display", lambda: False)
    printed, pages = {}, {}
    for address in (LOOPBACK, "0.0.0.0"):
        out = io.StringIO()
        pages[address] = announced(address, Console(file=out, width=300, force_terminal=True))
        printed[address] = [line for line in out.getvalue().splitlines() if set(line) & set("▀▄█")]
    assert printed[LOOPBACK] == []
    light = {"█": (1, 1), "▀": (1, 0), "▄": (0, 1), " ": (0, 0)}  # upper and lower half of a character
    halves = np.array([[light[each] for each in line] for line in printed["0.0.0.0"]], dtype=np.uint8)
    modules = halves.transpose(0, 2, 1).reshape(-1, halves.shape[1])
    picture = cv2.resize(255 * modules, None, fx=8, fy=8, interpolation=cv2.INTER_NEAREST)
    assert cv2.QRCodeDetector().detectAndDecode(picture)[0] == pages["0.0.0.0"]


@pytest.fixture
def own_address():
    """This machine's address on its network, which is not the loopback one; skips where there is none."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as way:
        try:
            way.connect(("203.0.113.1", 9))
        except OSError:
            lacks("a network", "connect it to one with a default route", required=False)
        return str(way.getsockname()[0])


def test_a_browser_elsewhere_gets_an_address_that_it_reaches_and_may_read(own_address, fuser, monkeypatch):
    hub = web_hub("0.0.0.0")
    text = said(WebPage(hub=hub), monkeypatch)
    assert "127.0.0.1" not in text
    assert text.count(f"http://{own_address}:") == 2  # the page, and in its address the data
    with session(fuser, None, hub):
        origin = f"http://{own_address}:{hub.web_port}"
        asked = {"Origin": origin, "Access-Control-Request-Method": "POST"}
        url = f"http://{own_address}:{hub.port}/rerun.sdk_comms.v1alpha1.MessageProxyService/ReadMessages"
        with urlopen(Request(url, method="OPTIONS", headers=asked), timeout=5.0) as answer:
            assert answer.headers["Access-Control-Allow-Origin"] == origin


def test_the_ports_for_browsers_are_fixed_and_the_next_ones_where_they_are_taken(monkeypatch):
    monkeypatch.setattr(hub_module, "PAGE_PORT", free_port())
    with socket.socket() as other:
        other.bind((LOOPBACK, 0))
        other.listen()
        taken = int(other.getsockname()[1])
        monkeypatch.setattr(hub_module, "DATA_PORT", taken)
        hub = Hub.on_free_ports(web=True)
    assert hub.web_port == hub_module.PAGE_PORT
    assert taken < hub.port < taken + 20
    usual = said(WebPage(hub=Hub(DATA_PORT, PAGE_PORT)), monkeypatch)
    address, hosts = usual.splitlines()
    assert address == "Viewer: http://127.0.0.1:9090/?url=rerun%2Bhttp://127.0.0.1:9876/proxy"
    assert hosts.startswith("Rerun's page requests a font and news")
    assert "latency" in said(WebPage(Hub(DATA_PORT, PAGE_PORT), live=True), monkeypatch)
    moved = said(WebPage(hub=Hub(DATA_PORT + 1, PAGE_PORT)), monkeypatch)
    assert moved.startswith("Port 9876 is taken: using 9877.\n")


def test_servers_that_start_at_once_each_show_their_own_session(fuser, tmp_path):
    """All chose the same ports; whoever binds them has them."""
    with session(fuser, tmp_path / "s.rrd") as live:
        live.write(frames(fuser, 1)[0])
    first = free_port(), free_port()
    hubs = [Hub(*first) for _ in range(4)]

    def serve(hub):
        with (tmp_path / "s.rrd").open("rb") as file:
            return hub.serve(file)

    with ThreadPoolExecutor() as pool:
        servers = list(pool.map(serve, hubs))
        try:
            with session(fuser, None, Hub(*first)) as live:
                servers.append(live.viewer.process)
                hubs.append(live.viewer.hub)
                ports = [ports_of(server.pid) for server in servers]
            assert ports == [{hub.port, hub.web_port} for hub in hubs]
            assert len(set().union(*ports)) == 2 * len(hubs)
        finally:
            for server in servers:
                stop(server)


def test_a_session_that_is_saved_goes_on_without_a_window(closed_display, monkeypatch, tmp_path):
    monkeypatch.setenv("DISPLAY", closed_display)

    def chosen(save):
        return choose_viewing(ViewerOptions(), save, live=True)

    viewing = chosen(tmp_path)
    assert isinstance(viewing, NoViewer)
    assert closed_display in viewing.why_not
    with pytest.raises(UsageError, match=rf"{closed_display} .* does not answer.* --save FILE.rrd"):
        chosen(None)


def test_a_browser_is_not_waited_for(monkeypatch, tmp_path):
    """``BROWSER`` may name a program that lasts as long as its page."""
    opened, closed, ended = (tmp_path / name for name in ("opened", "closed", "ended"))
    browser = tmp_path / "browser"
    wait = f"for k in $(seq 100); do [ -e {closed} ] && break; sleep 0.1; done"
    browser.write_text(f'#!/bin/sh\necho "$1" > {opened}\n{wait}\ntouch {ended}\n')
    browser.chmod(0o755)
    monkeypatch.setenv("BROWSER", f"{browser} %s")
    monkeypatch.setattr("viewer_app.viewer.web_page.has_display", lambda: True)
    hub = Hub(DATA_PORT, PAGE_PORT)
    WebPage(hub=hub).announce(Console(file=io.StringIO()))
    assert not ended.exists()
    assert eventually(lambda: opened.exists() and opened.read_text().strip() == hub.page)
    closed.touch()
    assert eventually(ended.exists)


# --- Replays and comparisons are written first and then shown, so that no viewer can delay them.


DATA = Path(__file__).parents[2] / "data"
BLUEPRINT = rrb.Blueprint(rrb.TextDocumentView(origin="/words", name="the only view"))


class Opened:
    """Replaces the viewer and records the files that it would show."""

    def __init__(self):
        self.read = []

    def __call__(self, arguments, stdin):
        assert "-" in arguments
        self.read.append(stdin.read())
        return SimpleNamespace(poll=lambda: 0), 0  # a user has closed it


@pytest.fixture
def headless(monkeypatch):
    """Viewers without a screen instead of windows: their processes and ports."""
    need_viewer()
    started = []

    def start(arguments, stdin):
        started.append(window.start_viewer(["--headless", *arguments], stdin))
        return started[-1]

    monkeypatch.setattr(file_window, "start_viewer", start)
    yield started
    for process, _ in started:
        stop(process)


@pytest.fixture
def opened(monkeypatch):
    viewer = Opened()
    monkeypatch.setattr(file_window, "start_viewer", viewer)
    return viewer


def write(save, window):
    def words(path):
        with whole_recording(path, BLUEPRINT) as stream:
            stream.log("/words", rr.TextDocument("S*"))

    with file_window.written_and_shown(save, words, force=False, window=window):
        pass


def test_the_window_gets_the_whole_file_and_the_file_its_name(opened, tmp_path):
    save = tmp_path / "s.rrd"
    write(save, window=True)
    assert damage_of(save) is None
    assert opened.read == [save.read_bytes()]


def test_without_a_name_the_file_lives_for_the_window_only(opened, tmp_path, monkeypatch):
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    write(None, window=True)
    (shown,) = opened.read
    assert list(tmp_path.iterdir()) == []
    again = tmp_path / "shown.rrd"
    again.write_bytes(shown)
    assert damage_of(again) is None


def test_a_failed_file_is_neither_kept_nor_shown(opened, tmp_path):
    def fail(path):
        path.touch()
        raise UsageError("…")

    with (
        pytest.raises(UsageError),
        file_window.written_and_shown(tmp_path / "s.rrd", fail, force=False, window=True),
    ):
        pass
    assert list(tmp_path.iterdir()) == []
    assert opened.read == []


def test_without_a_window_nothing_opens(opened, tmp_path):
    write(tmp_path / "s.rrd", window=False)
    write(None, window=False)
    assert opened.read == []


def test_a_viewer_that_is_interrupted_while_it_starts_is_gone(monkeypatch):
    """One without a window, of ``duplex doctor``, would run for ever."""
    sleeping = [sys.executable, "-c", "import time; time.sleep(60)"]
    process = subprocess.Popen(sleeping, start_new_session=True)

    def interrupt(*_):
        raise KeyboardInterrupt

    monkeypatch.setattr(window, "start", lambda *_: process)
    monkeypatch.setattr(window, "listens", interrupt)
    try:
        with pytest.raises(KeyboardInterrupt):
            window.start_viewer(["--headless"])
        assert process.poll() is not None
    finally:
        stop(process)


def test_a_viewer_shows_the_file_with_its_own_layout_after_the_file_is_gone(headless, monkeypatch):
    from rerun.experimental import ViewerClient

    monkeypatch.setattr(file_window, "_READS_WITHIN", 0.1)  # the file has no time to set
    write(None, window=True)
    ((_, port),) = headless
    viewer = ViewerClient.connect(f"rerun+http://{LOOPBACK}:{port}/proxy")
    assert eventually(lambda: [view.name for view in viewer.get_state().views] == ["the only view"], 30.0)


def test_a_session_of_version_0_1_is_shown_in_the_layout_of_today(headless, tmp_path):
    """No view complains that it lacks what older sessions do not have."""
    from rerun.experimental import ViewerClient

    old = tmp_path / "live.rrd"  # with depth images
    old.write_bytes(lzma.decompress((DATA / "version_0_1" / "live.rrd.xz").read_bytes()))
    session = Session.open(old)
    with file_window.in_this_layout(session, old, CoachPage("good")) as file:
        again = Session.open(file)
        assert again.fused.astype(np.float32).tobytes() == session.fused.astype(np.float32).tobytes()
        assert [event.text for event in again.events] == [event.text for event in session.events]
        assert sum(1 for _ in again.depth("a")) == sum(1 for _ in session.depth("a")) > 0
        assert file_window.show(file, 0)
    assert not file.exists()
    assert old.read_bytes() == lzma.decompress((DATA / "version_0_1" / "live.rrd.xz").read_bytes())
    ((_, port),) = headless
    viewer = ViewerClient.connect(f"rerun+http://{LOOPBACK}:{port}/proxy")
    assert eventually(lambda: any(view.name == SCENE for view in viewer.get_state().views), 30.0)
    assert eventually(lambda: not viewer.get_state().loading, 30.0)

    def complaints():
        return [(view.name, report.summary) for view in viewer.get_state().views for report in view.reports]

    # a busy viewer may draw a plot once before it has the mappings of its blueprint
    assert eventually(lambda: not complaints(), 30.0), complaints()


def test_the_time_cursor_of_a_new_window_stands_where_asked(headless, tmp_path):
    """Left alone, the viewer opens at the end of a file."""
    from rerun.experimental import ViewerClient

    path = tmp_path / "s.rrd"
    with whole_recording(path, BLUEPRINT) as stream:
        for second in range(9):
            stream.set_time(layout.TIME, duration=float(second))
            stream.log("/words", rr.TextDocument(f"{second} s"))
    assert file_window.show(path, 4_000_000_000)
    ((_, port),) = headless
    viewer = ViewerClient.connect(f"rerun+http://{LOOPBACK}:{port}/proxy")

    def cursor():
        return [(one.current_timeline, one.current_time) for one in viewer.get_state().recordings]

    assert eventually(lambda: cursor() == [(layout.TIME, 4_000_000_000)], 10.0), cursor()


@pytest.mark.parametrize(("exit_code", "within"), [(None, 0.2), (0, 3600.0)])
def test_a_window_that_takes_no_time_or_is_closed_is_given_up(exit_code, within, monkeypatch, tmp_path):
    path = tmp_path / "s.rrd"
    path.write_bytes(b"")
    process = SimpleNamespace(poll=lambda: exit_code)
    monkeypatch.setattr(file_window, "start_viewer", lambda *_: (process, free_port()))
    monkeypatch.setattr(file_window, "_READS_WITHIN", within)
    assert file_window.show(path, 1) is False


ROOT = Path(__file__).resolve().parents[3]
_STARTS_A_HUB = """
import sys
from viewer_app.viewer.hub import Hub
print(Hub.on_free_ports(web=False).start().pid, flush=True)
sys.stdin.read()
"""


def gone(pid):
    """Returns whether a process has ended, even if its exit code has not been read yet."""
    try:
        return psutil.Process(pid).status() == psutil.STATUS_ZOMBIE
    except psutil.NoSuchProcess:
        return True


@pytest.mark.parametrize("how", ["killed", "ended"])
def test_a_hub_does_not_outlive_the_program(how):
    with subprocess.Popen(
        [sys.executable, "-c", _STARTS_A_HUB], stdin=subprocess.PIPE, stdout=subprocess.PIPE, cwd=ROOT
    ) as program:
        hub = int(program.stdout.readline())
        assert not gone(hub)
        if how == "killed":
            if sys.platform != "linux":
                pytest.skip("only Linux ends the children of a program that is killed")
            program.kill()
        else:
            program.stdin.close()
        program.wait()
        assert eventually(lambda: gone(hub))


@pytest.mark.skipif(sys.platform != "linux", reason="signals to a process group")
def test_nothing_survives_sigterm_while_a_page_is_served(tmp_path):
    """Neither the server nor the session, which has no name of its own."""
    temporary = tmp_path / "temporary"
    temporary.mkdir()
    write_pair(tmp_path)
    files = (tmp_path / "a.csv", tmp_path / "b.csv")
    command = [sys.executable, "-m", "viewer_app.cli", "fuse", *map(str, files), "--offset", "0", "--web"]
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.STDOUT}
    environment = {**os.environ, "TMPDIR": str(temporary)}
    with subprocess.Popen(command, **pipes, cwd=ROOT, env=environment) as program:
        try:
            assert any(b"stays until Ctrl-C" in line for line in program.stdout)
            children = psutil.Process(program.pid).children(recursive=True)
            assert children
            assert list(temporary.iterdir())
            program.terminate()
            assert program.wait(30.0) in (0, 130)
        finally:
            program.kill()
    assert eventually(lambda: all(gone(child.pid) for child in children))
    assert not list(temporary.iterdir())
