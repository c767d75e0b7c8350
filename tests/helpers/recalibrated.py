"""Sessions as a live recorder writes them, and one that was calibrated several times."""

from contextlib import contextmanager
from uuid import uuid4

import rerun as rr

from devices.events import Event
from fusion.fuser import Fuser
from fusion.setup import FusionSetup
from recordings.data import layout
from recordings.data.session_arrays import SessionFrame
from recordings.session import Session
from recordings.writing.recorder import Recorder


@contextmanager
def recorder_to(path, setup, **how):
    """A recorder whose stream is a file, which is ended afterwards."""
    stream = rr.RecordingStream(layout.APPLICATION_ID, recording_id=uuid4())
    stream.save(path)
    recorder = Recorder(stream, setup, ("a", "b"), **how)
    yield recorder
    recorder.finish()
    stream.disconnect()


def record_recalibrated(path, pairs, calibrations):
    """Fuses pairs with a new calibration from each of the given frames on, and reads the session back."""
    fusers = [(first, Fuser(FusionSetup(calibration))) for first, calibration in calibrations]
    with recorder_to(path, fusers[0][1].setup) as recorder:
        for (first, fuser), end in zip(fusers, [*(f for f, _ in fusers[1:]), len(pairs)], strict=True):
            if first > 0:
                recorder.recalibrated(fuser.setup)
            recorder.event(Event(f"calibrated: {fuser.setup.calibration.how}"))
            recorder.record_all([SessionFrame(p, fuser.update(p.skeletons), 0) for p in pairs[first:end]])
    return Session.open(path)
