"""What a frame costs a viewer's stream, counted in messages: a guard of the live latency without a clock."""

from collections import Counter
from uuid import uuid4

import numpy as np
import rerun as rr

from recordings import layout
from recordings.session import Session
from recordings.writing.frame_columns import PLOTTED
from recordings.writing.recorder import Recorder
from tests.helpers.live_frames import frames, known_fuser

COUNT, PLOTS_EVERY = 40, 5


def written(path, plots_every):
    """A session of which each frame is recorded as it comes, as a viewer's."""
    fuser = known_fuser()
    stream = rr.RecordingStream(layout.APPLICATION_ID, recording_id=uuid4())
    stream.save(path)
    recorder = Recorder(stream, fuser.setup, ("a", "b"), depth_every=1, plots_every=plots_every)
    for frame in frames(fuser, COUNT):
        recorder.record_all([frame])
    recorder.finish()
    stream.disconnect()
    return path


def test_plots_in_blocks_lose_nothing(tmp_path):
    one, blocks = (Session.open(written(tmp_path / f"{n}.rrd", n)) for n in (1, PLOTS_EVERY + 2))
    assert blocks.damage is None
    assert len(one) == len(blocks) == COUNT
    for name, _, values in one.rows.figures():
        if name != "fuse_ms":
            np.testing.assert_array_equal(blocks.rows.filled(name), values, name)
    np.testing.assert_array_equal(blocks.fused_checksums, one.fused_checksums)


def test_a_frame_costs_a_viewer_few_messages(tmp_path, monkeypatch):
    """Each message takes 0.3 ms of the interpreter that sensors, fusion and file share, whatever it holds.

    A frame needs S_A, S_B, S* and the pelvis. Everything else comes once per block, or on change.
    """
    sent = Counter()

    def counted(name):
        original = getattr(rr.RecordingStream, name)

        def call(stream, entity, *what, **more):
            sent[entity] += not more.get("static", False)
            original(stream, entity, *what, **more)

        monkeypatch.setattr(rr.RecordingStream, name, call)

    counted("log")
    counted("send_columns")
    written(tmp_path / "s.rrd", PLOTS_EVERY)
    each = {layout.skeleton("a"), layout.skeleton("b"), layout.FUSED_SKELETON, layout.PELVIS}
    assert {entity for entity, count in sent.items() if count >= COUNT} == each
    assert all(sent[entity] <= COUNT // PLOTS_EVERY + 1 for entity in PLOTTED)
    assert sum(sent.values()) / COUNT < 6.0
