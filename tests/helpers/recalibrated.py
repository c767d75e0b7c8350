"""A session that was calibrated several times, as live ones are."""

from uuid import uuid4

import rerun as rr

from devices.events import Event
from fusion.fuser import Fuser
from fusion.setup import FusionSetup
from recordings.data import layout
from recordings.data.session_arrays import SessionFrame
from recordings.session import Session
from recordings.writing.recorder import Recorder


def record_recalibrated(path, pairs, calibrations):
    """Fuses pairs with a new calibration from each of the given frames on, and reads the session back."""
    stream = rr.RecordingStream(layout.APPLICATION_ID, recording_id=uuid4())
    stream.save(path)
    fusers = [(first, Fuser(FusionSetup(calibration))) for first, calibration in calibrations]
    recorder = Recorder(stream, fusers[0][1].setup, ("a", "b"))
    for (first, fuser), end in zip(fusers, [*(f for f, _ in fusers[1:]), len(pairs)], strict=True):
        if first > 0:
            recorder.recalibrated(fuser.setup)
        recorder.event(Event(f"calibrated: {fuser.setup.calibration.how}"))
        recorder.record_all([SessionFrame(p, fuser.update(p.skeletons), 0) for p in pairs[first:end]])
    recorder.finish()
    stream.disconnect()
    return Session.open(path)
