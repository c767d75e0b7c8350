"""``duplex live`` on Orbbec sensors, on Kinects v1, and on Azure Kinects with the program's own tracker."""

import sys

import pytest

from devices.blazepose.blazepose import BlazePose
from fusion.body import BLAZEPOSE
from fusion.calibration.calibration import nominal_calibration
from fusion.fuser import Fuser
from fusion.setup import FusionSetup
from fusion.skeleton import Skeleton
from recordings.session import Session
from tests.helpers.command_line import duplex
from tests.helpers.freenect import film, numbered, write_dump
from tests.helpers.orbbec import standin_values as values
from tests.helpers.orbbec.standin import Orbbec
from tests.helpers.session_text import rows_of
from tests.helpers.standin_pyk4a import Device
from tests.helpers.two_views import moving
from viewer_app.sinks.live_session import LiveSession

A, B = "CL8H741005K", "CL8H7410123"
MODES = values.OBMultiDeviceSyncMode


@pytest.fixture
def own_tracker(monkeypatch):
    """A stand-in for the program's tracker, without networks. It finds a standing person in each image."""
    images = []
    standing = moving(BLAZEPOSE, 1)[0]

    def track(_self, image, depth, _camera, time_ns):
        assert image.shape[:2] == depth.shape
        images.append(image)
        return {"1": Skeleton.of(BLAZEPOSE, standing, time_ns=time_ns)}

    monkeypatch.setattr(BlazePose, "__enter__", lambda self: self)
    monkeypatch.setattr(BlazePose, "track", track)
    monkeypatch.setattr("viewer_app.sensors.tracker.ensure_networks", lambda *_: False)
    Fuser(FusionSetup(nominal_calibration(BLAZEPOSE))).warm_up()  # compiling takes longer than these sessions
    return images


@pytest.fixture
def bolts(orbbecs, own_tracker, monkeypatch):
    """Two Femto Bolts at a real sensor's pace, on a machine without pyk4a."""
    assert own_tracker == []
    monkeypatch.setitem(sys.modules, "pyk4a", None)
    orbbecs.devices = [Orbbec(A, paced=True), Orbbec(B, paced=True)]
    return orbbecs


def _live(*arguments, seconds=1.0):
    return duplex("live", "--kinect-a", A, "--kinect-b", B, "--no-viewer", "--seconds", seconds, *arguments)


def test_two_orbbec_sensors_become_a_session(bolts, tmp_path, capsys):
    saved = tmp_path / "live.rrd"
    assert _live("--save", saved) == 0
    said = " ".join(capsys.readouterr().out.split())
    assert "Body tracker: blazepose full (" in said
    assert "Saved" in said
    assert "software does not say whether a sync cable is in" in said
    session = Session.open(saved)
    assert (session.tracker, session.body) == ("blazepose full", BLAZEPOSE)
    assert session.sources == (A, B)
    assert 0 < len(session) <= 1 + min(device.given for device in bolts.devices)
    assert session.intrinsics_a.width == 320, "half of the depth image"
    assert rows_of(saved, "/kinect_a/depth") > 0
    assert bolts.open_serials == []
    assert [device.sync["mode"] for device in bolts.devices] == [MODES.STANDALONE] * 2
    assert duplex("info", saved) == 0
    assert "blazepose full" in capsys.readouterr().out


def test_two_kinects_v1_become_a_session(fakenect, own_tracker, tmp_path, capsys, monkeypatch):
    for module in ("pyk4a", "pyorbbecsdk"):
        monkeypatch.setitem(sys.modules, module, None)
    depth, rgb = (images[0] for images in numbered(1))
    for serial in (A, B):
        fakenect.dumps[serial] = write_dump(tmp_path / serial, film([depth] * 900, [rgb] * 900))
    saved = tmp_path / "live.rrd"
    assert _live("--save", saved) == 0
    said = " ".join(capsys.readouterr().out.split())
    assert f"No sync cable fits into {A} and {B}. Pairs are up to half a frame apart" in said
    assert "counts as ideal, with 525 pixels" in said
    session = Session.open(saved)
    assert (session.tracker, session.sources) == ("blazepose full", (A, B))
    assert len(session) > 0
    assert session.intrinsics_a.width == 320, "half of the depth image"
    assert {image.shape for image in own_tracker} == {(480, 640, 3)}, "the colour images"
    assert fakenect.open == []


def test_the_named_master_leads(bolts, tmp_path):
    saved = tmp_path / "live.rrd"
    assert _live("--sync-master", A, "--save", saved) == 0
    assert bolts.started == [B, A], "the secondary first"
    assert [device.sync["mode"] for device in bolts.devices] == [MODES.PRIMARY, MODES.SECONDARY]
    assert len(Session.open(saved)) > 0


def test_impossible_options_give_one_line(bolts, capsys):
    for arguments, message in (
        (("--tracker", "k4abt"), f"{A}: k4abt accepts images of libk4a only"),
        (("--color", "3072P", "--fps", 15), "Orbbec's sensors have no colour 3072P"),
        (("--sync-master", "999"), "--sync-master 999 is neither of the two"),
    ):
        assert _live(*arguments, seconds=0.2) == 2
        said = capsys.readouterr().err
        assert message in said
        assert said.count("\n") == 1
    assert bolts.open_serials == []


def test_azure_kinects_are_tracked_by_our_tracker(bus, own_tracker, tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "pyorbbecsdk", None)
    bus.devices = [Device("000123", paced=True), Device("000456", paced=True)]
    saved = tmp_path / "live.rrd"
    code = duplex(
        *("live", "--kinect-a", "000123", "--kinect-b", "000456", "--tracker", "blazepose"),
        *("--tracker-network", "lite", "--no-viewer", "--seconds", 1.0, "--save", saved),
    )
    assert code == 0
    session = Session.open(saved)
    assert (session.tracker, session.body) == ("blazepose lite", BLAZEPOSE)
    assert len(session) > 0
    assert {int(image[0, 0]) for image in own_tracker} == {900}, "the infrared images"


def _view_names(blueprint):
    def names(part):
        return {str(part.name)}.union(
            *(names(inner) for inner in getattr(part, "contents", ()) if hasattr(inner, "name"))
        )

    return names(blueprint.root_container)


@pytest.mark.parametrize(("depth", "shown"), [("half", True), ("none", False)])
def test_the_viewer_shows_the_infrared_that_our_tracker_works_on(bolts, depth, shown, monkeypatch):
    assert len(bolts.devices) == 2
    given = []

    class Watched(LiveSession):
        def __init__(self, setup, sources, blueprint, **more):
            given.append((blueprint, more["file_blueprint"]))
            super().__init__(setup, sources, blueprint, **more)

    monkeypatch.setattr("viewer_app.running.runner.LiveSession", Watched)
    assert _live("--depth", depth, seconds=0.5) == 0
    ((viewer, file),) = (tuple(map(_view_names, pair)) for pair in given)
    infrared = {"Kinect A, infrared", "Kinect B, infrared"}
    assert infrared <= viewer if shown else not infrared & viewer
    panes = {"Kinect A", "Kinect B"} if shown else {"Kinect A: its skeleton", "Kinect B: its skeleton"}
    assert panes <= file, "files hold no infrared"
    assert not infrared & file
