"""Fuses pairs to a session on disk, without a viewer."""

from uuid import uuid4

import pytest

from devices.events import Event
from fusion.fuser import Fuser
from fusion.setup import FusionSetup
from recordings.file.session_writer import write_session
from recordings.images import PairImages
from recordings.session import Session
from recordings.session_arrays import SessionFrame


def record_fused(path, pairs, calibration, settings=None, depth_every=0, block=256):
    """Fuses pairs, records them to a file, and reads the file back."""
    setup = FusionSetup(calibration, settings)
    fuser = Fuser(setup)
    frames = [SessionFrame(pair, fuser.update(pair.skeletons), 0) for pair in pairs]
    session = Session.of(
        [(setup, frames)],
        events=(Event(f"calibrated: {calibration.how}"),),
        images=PairImages([frame.pair for frame in frames], depth_every),
    )
    write_session(session, path, block=block)
    return Session.open(path)


@pytest.fixture
def fused_run(tmp_path):
    """A function like :func:`record_fused` without the path; each call records a new session."""
    return lambda *pairs_and_calibration, **more: record_fused(
        tmp_path / f"{uuid4()}.rrd", *pairs_and_calibration, **more
    )
