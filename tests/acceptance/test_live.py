"""``duplex live`` on the real libraries of RealSense and Kinect v1, with the program's own body tracker."""

import numpy as np

from recordings import Session
from recordings.errors import RecordingError
from tests.helpers.freenect import fakenect_file
from tests.helpers.machine import need_networks
from tests.helpers.plugged_in import SERIALS, dump_freenects, record_realsenses
from tests.helpers.programs import ROOT, typed
from tests.helpers.waiting import eventually

_SECONDS = 12
_FRAMES = 10


def test_two_realsenses(rs, tmp_path, home):
    need_networks()
    record_realsenses(rs, tmp_path, _SECONDS)
    captured_and_reviewed("realsense", tmp_path, home)


def test_two_kinects_v1(tmp_path, home):
    need_networks()
    fakenect_file()
    dump_freenects(tmp_path, _SECONDS)
    captured_and_reviewed("freenect", tmp_path, home)


def captured_and_reviewed(library, tmp_path, home):
    """Captures until Ctrl-C, once some frames are in the file, and reviews what was saved."""
    saved = tmp_path / "s.rrd"
    line = f"python -m tests.helpers.plugged_in {library} {tmp_path} live --save {saved}"
    line += f" --principal {SERIALS[1]}"
    with typed(line, ROOT, **home, PYTHONPATH=str(ROOT)) as live:
        assert live.says("Running"), live.said
        assert eventually(lambda: frames_with_a_person(saved) >= _FRAMES, 300.0, every=0.5), live.said
        assert live.end() == 0, live.said
    assert "Body tracker: blazepose" in live.said
    session = Session.open(saved)
    assert session.sources == (SERIALS[1], SERIALS[0])
    assert len(session) >= _FRAMES
    with typed(f"duplex review {saved}", tmp_path, **home) as review:
        assert review.code() == 0, review.said
    assert "Verdict" in review.said


def frames_with_a_person(saved):
    """How many frames of a growing session have S*."""
    try:
        return int(np.isfinite(Session.open(saved).fused).all(axis=2).any(axis=1).sum())
    except (OSError, RecordingError):
        return 0
