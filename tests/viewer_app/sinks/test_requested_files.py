"""Sessions that a page begins and ends while a run goes on."""

import json
from datetime import datetime
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st
from websockets.sync.client import connect

from devices.events import Event
from recordings.session import Session
from tests.helpers.live_frames import frames, known_fuser
from tests.helpers.machine import small_disk
from tests.helpers.network import free_port
from tests.helpers.screens import browser
from tests.helpers.waiting import eventually
from viewer_app.outputs import output
from viewer_app.outputs.websocket import WebSocketOutput
from viewer_app.sinks.live_session import LiveSession
from viewer_app.sinks.requested_files import free_path
from viewer_app.viewer.blueprint import session_blueprint

FUSER = known_fuser()
FRAMES = frames(FUSER, 24)


class Requests:
    """Asks before given frames, and keeps what it is told."""

    def __init__(self, asks):
        self.asks, self.told, self.frame = asks, [], -1

    def take_request(self):
        self.frame += 1
        return self.asks.get(self.frame)

    def tell_saving(self, state, text):
        self.told.append((state, text))


def live(requests, **how):
    blueprint = session_blueprint(FUSER.setup, np.array([0.0, 0.0, 2.6]), "inspect")
    return LiveSession(FUSER.setup, ("a", "b"), blueprint, requests=requests, **how)


@given(asks=st.dictionaries(st.integers(0, len(FRAMES) - 1), st.booleans(), max_size=6))
@example(asks={0: True, 2: False, 3: True, 4: False, 5: True})
@settings(max_examples=6, suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_each_frame_between_two_requests_is_in_one_file(asks, tmp_path, monkeypatch):
    folder = tmp_path / str(len(list(tmp_path.iterdir())))
    folder.mkdir()
    monkeypatch.chdir(folder)
    requests = Requests(asks)
    with live(requests) as session:
        for frame in FRAMES:
            session.write(frame)
    expected, saving = [], False
    for k, frame in enumerate(FRAMES):
        wanted = asks.get(k, saving)
        if wanted and not saving:
            expected.append([])
        saving = wanted
        if saving:
            expected[-1].append(frame.fused.positions)
    files = session.files
    assert sorted(folder.iterdir()) == sorted(file.path.absolute() for file in files)
    assert len(files) == len(expected)
    for file, fused in zip(files, expected, strict=True):
        saved = Session.open(file.path)
        assert saved.damage is None
        np.testing.assert_allclose(saved.fused, fused, atol=1e-6)
    assert [state for state, _ in requests.told if state == "saved"] == ["saved"] * len(files)


def test_a_full_disk_is_told_while_it_is_waited_for(tmp_path, monkeypatch):
    requests = Requests({0: True})
    with small_disk(tmp_path / "small", 4) as disk:
        monkeypatch.chdir(disk)
        with live(requests) as session:
            session.write(FRAMES[0])
            (file,) = session.files
            assert session.open_file is file
            assert eventually(lambda: file.waited)
            for frame in FRAMES[1:3]:
                session.write(frame)
            assert requests.told[2:] == [("saving", file.waited)]
        monkeypatch.chdir(tmp_path)
    assert requests.told[-1] == ("failed", file.failure)
    assert "No space left on device" in file.failure
    assert session.open_file is None


@pytest.mark.parametrize("gone", [False, True])
def test_that_nothing_can_be_saved_in_a_folder_is_told_at_once(gone, tmp_path, monkeypatch):
    folder = tmp_path / "here"
    folder.mkdir()
    monkeypatch.chdir(folder)
    if gone:
        folder.rmdir()
    else:  # root may write everywhere
        monkeypatch.setattr("os.access", lambda path, how: Path(path) != folder)
    requests = Requests({0: True, 3: True})
    with live(requests) as session:
        session.write(FRAMES[0])
        (state, text) = requests.told[-1]
        assert state == "failed"
        assert gone or text == f"The folder {folder} is not writable."
        session.write(FRAMES[1])
        monkeypatch.undo()
        monkeypatch.chdir(tmp_path)
        for frame in FRAMES[2:6]:
            session.write(frame)
    assert requests.told[-1][0] == "saved"
    assert [len(Session.open(file.path)) for file in session.files] == [3]


def test_a_fault_of_the_writer_is_told_and_raised(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("viewer_app.sinks.session_file.write_items", lambda *_: 1 / 0)
    requests = Requests({0: True, 1: False})
    session = live(requests)
    for frame in FRAMES[:2]:
        session.write(frame)
    with pytest.raises(ZeroDivisionError):
        session.close()
    state, text = requests.told[-1]
    assert state == "failed"
    assert text.startswith(session.files[0].path.name)


def test_a_name_is_that_of_no_file(tmp_path):
    now, seen, taken = datetime(2026, 1, 2, 3, 4, 5), set(), []
    for made in (Path.touch, taken.append, Path.touch):
        path = free_path(tmp_path, now, taken)
        made(path)
        seen.add(path.name)
    assert seen == {f"duplex-20260102-030405{more}.rrd" for more in ("", "-2", "-3")}


@pytest.fixture
def server():
    output = WebSocketOutput(free_port(), FUSER.setup)
    output.allow_requests()
    yield output
    output.close()


def said_by(client, kind):
    return next(said for said in map(json.loads, client) if said["type"] == kind)


@given(
    wrong=st.sampled_from([
        "save", 7, None, [], {"type": "save", "on": True}, {"type": "save", "on": "yes", "token": "TOKEN"},
        {"type": "save", "on": True, "token": ["TOKEN"]}, {"type": "frame", "on": True, "token": "TOKEN"},
        {"type": "save", "on": True, "token": "\ud800"}, {"type": "save", "on": True, "token": "TOKEN0"},
        {"type": "save", "on": None, "token": "old"}, {"type": "save", "token": "TOKEN"},
    ])
)  # fmt: skip
@settings(max_examples=20, suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_only_the_token_begins_a_file(wrong, server):
    base, _, token = server.page.partition("/#")
    before = server.ignored
    with connect(base.replace("http", "ws")) as client:
        client.send(json.dumps(wrong).replace('"TOKEN"', json.dumps(token)))
        assert eventually(lambda: server.ignored == before + 1)
        assert server.take_request() is None
        for on in (True, False):
            client.send(json.dumps({"type": "save", "on": on, "token": token}))
            assert eventually(lambda: server._request)
            assert server.take_request() is on
    assert server.ignored == before + 1


def test_who_asks_is_told_whether_the_token_is_right(server):
    base, _, token = server.page.partition("/#")
    with connect(base.replace("http", "ws")) as client:
        for given_, may in ((token, True), ("old", False), ("", False)):
            client.send(json.dumps({"type": "save", "on": None, "token": given_}))
            assert said_by(client, "may_save")["may"] is may
    assert server.ignored == 2
    assert server.take_request() is None


def test_a_page_begins_and_ends_a_file(server, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(output, "_SILENT_S", 60.0)  # a busy machine makes long pauses
    with browser(bypass_csp=True) as context, live(server, others=[server]) as session:
        tabs = [context.new_page() for _ in range(3)]
        button, base = tabs[0].locator("#save"), server.page.partition("/#")[0]
        for tab, page in zip(tabs, (server.page, base, f"{base}/#old"), strict=True):
            tab.goto(page)
            tab.wait_for_function("skeleton.saving && skeleton.saving.state === 'ready'")
        for tab in (tabs[0], tabs[2]):
            tab.wait_for_function("typeof skeleton.may === 'boolean'")
        assert not tabs[2].locator("#save").is_visible(), "the token of an earlier run"
        assert "earlier run" in tabs[2].locator("#event").inner_text()
        assert not tabs[1].locator("#save").is_visible(), "a page without the token"
        for count, (state, word) in enumerate((("saving", "Stop saving"), ("saved", "Save again"))):
            button.click()
            assert eventually(lambda: server._request)
            for frame in FRAMES[12 * count : 12 * count + 12]:
                session.write(frame)
            for tab in tabs:
                tab.wait_for_function(f"skeleton.saving.state === '{state}'")
            assert button.inner_text() == word
        (file,) = session.files
        assert tabs[1].locator("#event").inner_text() == f"Saved {file.path.name}"
        why = "session.rrd could not be written: No space left on device."
        server.tell_saving("failed", why)
        tabs[0].wait_for_function("skeleton.saving.state === 'failed'")
        server.event(Event("A sees somebody else."))
        session.recalibrated(FUSER.setup)
        session.write(FRAMES[0])
        tabs[0].wait_for_function("skeleton.frame.time_s === 0")
        assert tabs[0].locator("#event").inner_text() == why, "no event takes its place"
        server.close()  # another program may answer, which saves nothing
        tabs[0].wait_for_function("skeleton.hello === null && !skeleton.saving")
    assert len(Session.open(file.path).rows) == 12
