"""Fuses pairs to a session on disk, without a viewer."""

from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory

from devices.events import Event
from fusion.fuser import Fuser
from fusion.setup import FusionSetup
from recordings.data.images import Images, SessionImages
from recordings.data.session_arrays import SessionFrame
from recordings.file.session_writer import write_session
from recordings.session import Session
from tests.helpers.frame_pairs import frame_pairs
from tests.helpers.two_views import calibration_of


class FrameImages(SessionImages):
    """The images of every n-th frame in memory; 0 for none."""

    def __init__(self, frames, every):
        self._frames, self._every = frames, every

    def depth(self, side, frames):
        return Images(lambda: self._of(side, frames, "depth"))

    def color(self, side, frames):
        return Images(lambda: self._of(side, frames, "color"))

    def _of(self, side, frames, kind):
        for k in frames:
            seen = getattr(self._frames[k].pair, side)
            if self._every and k % self._every == 0 and seen is not None and getattr(seen, kind) is not None:
                yield k, getattr(seen, kind)


GAP = (20, 21, 22)
"""The frames in which no sensor sees the person of :func:`record_with_a_gap`."""


def record_with_a_gap(path, body, frames=60, gap=GAP, jitter_ns=3_000_000):
    """A moving person, whom no sensor sees in some frames; timestamps jitter. Recorded once, then copied."""
    path.write_bytes(_with_a_gap(body, frames, gap, jitter_ns))
    return Session.open(path)


@cache
def _with_a_gap(body, frames, gap, jitter_ns):
    with TemporaryDirectory() as folder:
        pairs = frame_pairs(body, frames, gap=gap, jitter_ns=jitter_ns)
        return record_fused(Path(folder) / "s.rrd", pairs, calibration_of(body)).path.read_bytes()


def record_fused(path, pairs, calibration, settings=None, depth_every=0, block=256):
    """Fuses pairs, records them to a file, and reads the file back."""
    setup = FusionSetup(calibration, settings)
    fuser = Fuser(setup)
    frames = [SessionFrame(pair, fuser.update(pair.skeletons), 0) for pair in pairs]
    session = Session.of(
        [(setup, frames)],
        events=(Event(f"calibrated: {calibration.how}"),),
        images=FrameImages(frames, depth_every),
    )
    write_session(session, path, block=block)
    return Session.open(path)
