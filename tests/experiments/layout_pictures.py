"""Makes the pictures of the viewer's layouts for the documentation.

``python -m tests.experiments.layout_pictures`` runs ``duplex demo``, ``duplex fuse`` on real recordings, and
``duplex demo --tracker blazepose``. It draws their layouts in a viewer without a screen and writes
``docs/pictures/*.png``. A graphics driver or Debian's mesa-vulkan-drivers is needed. What is missing for a
run is said, and its pictures stay as they are: the recordings (``DUPLEX_SHARED``) or the networks.
"""

import contextlib
import io
import os
import socket
import tempfile
import threading
from pathlib import Path
from unittest import mock

import numpy as np
import rerun as rr
import rerun.blueprint as rrb
from PIL import Image

from devices.blazepose.networks.files import cache_folder, missing
from recordings import Session
from recordings.data import layout
from recordings.file.rrd_file import RrdFile
from tests.helpers.pictures import headless_viewer
from tests.helpers.waiting import eventually
from viewer_app.addresses import LOOPBACK
from viewer_app.cli import main
from viewer_app.viewer.blueprint import session_blueprint
from viewer_app.viewer.hub import Hub
from viewer_app.viewer.stored_clouds import has_depth, send_computed
from viewer_app.viewer.viewer_choice import Viewing

ROOT = Path(__file__).resolve().parents[2]
PICTURES = ROOT / "docs" / "pictures"
SHARED = Path(os.environ.get("DUPLEX_SHARED", ROOT.parent / "shared"))
WALK = SHARED / "real" / "kinect_v2_90deg_walk"
SIZE = (1280, 720)
MENU = 37
"""Pixels: height of the menu, which is cut off."""
WINDOW = SIZE[0], SIZE[1] + MENU
_LIMIT = 250_000
"""Bytes of a picture."""
_COLORS = (256, 128, 64, 32)
_CALIBRATED_S = 4.0
"""When the person of the demo has left the start-up pose."""
_TRACKING_S = 6.0
"""When a slow machine shows infrared images, too."""


def drawn(file, moments, clouds):
    """The layouts of a saved session."""
    session = Session.open(file)
    with RrdFile(file) as opened:
        identity = opened.identity()
    setup = session.last_setup
    found = {}
    # read from a pipe, a recording keeps its identity: what is sent afterwards joins it
    with file.open("rb") as data, headless_viewer("-", size=WINDOW, stdin=data) as client:
        if clouds:
            send_computed(file, client.url)
        stream = rr.RecordingStream(identity[0], recording_id=identity[1], send_properties=False)
        stream.connect_grpc(client.url)
        for name, moment in moments.items():
            before = blueprint_of(client)
            blueprint = session_blueprint(setup, session.whereabouts, name, depth=has_depth(session))
            stream.send_blueprint(without_menu(blueprint))
            stream.flush(timeout_sec=20.0)
            eventually(lambda before=before: blueprint_of(client) != before, 60.0)
            found[name] = settled_picture(client, moment)
        stream.disconnect()
    return found


def blueprint_of(client):
    """The id of the layout that is shown; empty before there is one."""
    try:
        return str(client.get_blueprint().blueprint_id)
    except (ConnectionError, RuntimeError, ValueError):
        return ""


def without_menu(blueprint):
    """The layout without the viewer's menu, in which it warns of a machine without a graphics card."""
    panels = (blueprint.blueprint_panel, blueprint.selection_panel, blueprint.time_panel)
    return rrb.Blueprint(blueprint.root_container, *panels, rrb.TopPanel(state="hidden"), auto_views=False)


def settled_picture(client, moment):
    """The window at a moment, as soon as it is drawn three times alike."""
    pictures = []

    def settled():
        try:
            client.set_time(layout.TIME, duration=moment, play_state="paused")
            window = Image.open(io.BytesIO(client.take_screenshot())).convert("RGB")
            pictures.append(window.crop((0, MENU, SIZE[0], SIZE[1] + MENU)).tobytes())
        except (ConnectionError, RuntimeError, ValueError):  # the file is not loaded yet
            return False
        return len(pictures) > 8 and pictures[-1] == pictures[-2] == pictures[-3]

    if not eventually(settled, 90.0):
        raise TimeoutError(f"The viewer does not come to rest at {moment:g} s.")
    return Image.frombytes("RGB", SIZE, pictures[-1])


def write_png(path, picture):
    """Writes a PNG file with as many colours as fit into the limit."""
    for colors in _COLORS:
        made = io.BytesIO()
        reduced = picture.quantize(colors, Image.Quantize.MEDIANCUT, kmeans=3, dither=Image.Dither.NONE)
        reduced.save(made, "PNG", optimize=True)
        if len(made.getvalue()) < _LIMIT:
            path.write_bytes(made.getvalue())
            print(f"{path.name}: {len(made.getvalue()) / 1e3:.0f} kB, {colors} colours")
            return
    raise ValueError(f"{path.name} does not fit into {_LIMIT} bytes.")


def hard_moment(session):
    """Seconds: the middle of the second in which the views differ most, after the start-up pose."""
    later = session.time_ns > 4_000_000_000
    apart = np.convolve(np.nan_to_num(session.quality.disagreement[later]), np.ones(30) / 30, "valid")
    return float(session.time_ns[later][np.argmax(apart) + 15] * 1e-9)


def of_demo(folder):
    """The three layouts of ``duplex demo``; *setup* live, as only then it says what to do next."""
    file = folder / "demo.rrd"
    main(["demo", "--seconds", "16", "--no-viewer", "--quiet", "--save", str(file)])
    opened = Session.open(file)
    moment = hard_moment(opened)
    write_png(PICTURES / "setup.png", live_picture(folder, (), _CALIBRATED_S))
    moments = {"inspect": moment, "report": moment}
    for name, picture in drawn(file, moments, clouds=True).items():
        write_png(PICTURES / f"{name}.png", picture)


def of_two_people(folder):
    """*setup* of a demo of two people, where both sensors see both."""
    file = folder / "people.rrd"
    two = "--people", "2", "--motion", "squat"
    main(["demo", *two, "--seconds", "12", "--no-viewer", "--quiet", "--save", str(file)])
    opened = Session.open(file)
    others = [dict(opened.images.others(side, range(len(opened)))) for side in layout.VIEWS]
    both = [
        k for k in others[0] if len(others[0][k]) and len(others[1].get(k, ())) and opened.time_ns[k] > 8e9
    ]
    moments = {"setup": float(opened.time_ns[both[len(both) // 2]] * 1e-9)}
    write_png(PICTURES / "people.png", drawn(file, moments, clouds=True)["setup"])


def of_walk(folder):
    """*inspect* and *report* of two real recordings, which have no images for *setup*."""
    if not WALK.is_dir():
        print(f"No recordings {WALK}: the pictures of a real walk stay as they are.")
        return
    file = folder / "walk.rrd"
    main(["fuse", str(WALK / "a.csv"), str(WALK / "b.csv"), "--no-viewer", "--save", str(file)])
    moment = hard_moment(Session.open(file))
    moments = dict.fromkeys(("inspect", "report"), moment)
    for name, picture in drawn(file, moments, clouds=False).items():
        write_png(PICTURES / f"{name}_real.png", picture)


def of_own_tracker(folder):
    """*setup* of ``duplex demo --tracker blazepose``, with the infrared images that a live viewer shows."""
    if missing("full", cache_folder()):
        print("No networks (duplex tracker fetch): setup_infrared.png stays as it is.")
        return
    write_png(PICTURES / "setup_infrared.png", live_picture(folder, ("--tracker", "blazepose"), _TRACKING_S))


def live_picture(folder, options, moment):
    """*setup* of a running ``duplex demo`` with these options."""
    hub = Hub.on_free_ports(web=False)
    shown = []
    options = [*options, "--layout", "setup", "--seconds", "8", "--quiet"]
    with contextlib.ExitStack() as opened:

        def show():
            if eventually(lambda: _listens(hub.port), 300.0):
                shown.append(opened.enter_context(headless_viewer("--connect", hub.url, size=WINDOW)))

        thread = threading.Thread(target=show, daemon=True)
        thread.start()
        with mock.patch("viewer_app.running.runner.choose_viewing", return_value=Viewing(hub=hub)):
            main(["demo", *options, "--save", str(folder / "live.rrd")])
        thread.join()
        (client,) = shown
        client.run_command("ui.toggle_top_panel")
        return settled_picture(client, moment)


def _listens(port):
    try:
        socket.create_connection((LOOPBACK, port), timeout=0.5).close()
    except OSError:
        return False
    return True


if __name__ == "__main__":
    for make in (of_demo, of_two_people, of_walk, of_own_tracker):
        with tempfile.TemporaryDirectory() as at:
            make(Path(at))
