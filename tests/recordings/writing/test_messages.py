"""What a frame costs a viewer's stream in messages, and columns as Rerun makes them."""

from collections import Counter
from uuid import uuid4

import numpy as np
import pytest
import rerun as rr

from recordings.data import layout
from recordings.session import Session
from recordings.writing.arrow_columns import Column, Times, converted, depth_image, points, state_changes
from recordings.writing.frame_columns import PLOTTED
from recordings.writing.recorder import Recorder
from tests.helpers.live_frames import frames, known_fuser

COUNT, PLOTTED_TOGETHER = 40, 5


def written(path, plotted_together):
    """A session of which each frame is recorded as it comes, as a viewer's; with 1, as a file's."""
    fuser = known_fuser()
    stream = rr.RecordingStream(layout.APPLICATION_ID, recording_id=uuid4())
    stream.save(path)
    later = plotted_together > 1
    recorder = Recorder(stream, fuser.setup, ("a", "b"), depth_every=1, plots_later=later)
    for frame in frames(fuser, COUNT):
        recorder.record_all([frame])
        if recorder.unplotted >= plotted_together:
            recorder.plot()
    recorder.finish()
    stream.disconnect()
    return path


def test_plots_in_blocks_lose_nothing(tmp_path):
    one, blocks = (Session.open(written(tmp_path / f"{n}.rrd", n)) for n in (1, PLOTTED_TOGETHER + 2))
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
    written(tmp_path / "s.rrd", PLOTTED_TOGETHER)
    each = {layout.skeleton("a"), layout.skeleton("b"), layout.FUSED_SKELETON, layout.PELVIS}
    assert {entity for entity, count in sent.items() if count >= COUNT} == each
    assert all(sent[entity] <= COUNT // PLOTTED_TOGETHER + 1 for entity in PLOTTED)
    assert sum(sent.values()) / COUNT < 6.0


FRAMES, POINTS = 3, 4
RANDOM = np.random.default_rng(0)
VALUES = {
    ("Points3D", "positions"): RANDOM.normal(size=(FRAMES, POINTS, 3)).astype(np.float32),
    ("Points3D", "colors"): RANDOM.integers(0, 256, (FRAMES, POINTS, 3)).astype(np.uint8),
    ("Points3D", "class_ids"): RANDOM.integers(0, 9, (FRAMES, POINTS)).astype(np.uint16),
    ("Transform3D", "mat3x3"): RANDOM.normal(size=(FRAMES, 3, 3)).astype(np.float32),
    ("Transform3D", "translation"): RANDOM.normal(size=(FRAMES, 3)).astype(np.float32),
}


def assert_same(ours, theirs):
    """Two columns or batches are the same, also in their types."""
    assert ours.component_descriptor() == theirs.component_descriptor()
    assert ours.as_arrow_array().equals(theirs.as_arrow_array())
    assert ours.as_arrow_array().type == theirs.as_arrow_array().type


@pytest.mark.parametrize(("archetype", "argument"), VALUES)
def test_an_argument_of_an_archetype_becomes_what_rerun_makes_of_it(archetype, argument):
    values, each = VALUES[archetype, argument], POINTS if archetype == "Points3D" else 1
    flat = values.reshape(FRAMES * each, *values.shape[2 if each > 1 else 1 :])
    kind = getattr(rr, archetype)
    (theirs,) = kind.columns(**{argument: flat}).partition([each] * FRAMES)
    ours = Column(*converted(kind, argument, values, FRAMES * each), FRAMES)
    assert ours.component_descriptor() == theirs.component_descriptor()
    assert ours.as_arrow_array().equals(theirs.as_arrow_array())
    assert ours.as_arrow_array().type.value_type == theirs.as_arrow_array().type.value_type


@pytest.mark.parametrize("count", [0, 1, 7])
def test_points_become_what_rerun_makes_of_them(count):
    values = RANDOM.normal(size=(count, 3)).astype(np.float32)
    (ours,) = points(values)
    (theirs,) = rr.Points3D.from_fields(positions=values).as_component_batches()
    assert_same(ours, theirs)


def test_an_image_becomes_what_rerun_makes_of_it():
    theirs = rr.EncodedDepthImage(b"a blob", media_type="application/rvl", meter=1000.0)
    ours = depth_image(b"a blob", "application/rvl", 1000.0)
    for mine, their in zip(ours, theirs.as_component_batches(), strict=True):
        assert_same(mine, their)


def test_states_become_what_rerun_makes_of_them():
    states = ["from A", "from both", "from A"]
    (ours,), (theirs,) = state_changes(states), rr.StateChange.columns(state=states)
    assert_same(ours, theirs)


def test_times_become_what_rerun_makes_of_them():
    numbers = np.arange(5)
    spans = numbers.astype("timedelta64[ns]")
    for ours, theirs in (
        (Times("frame", numbers), rr.TimeColumn("frame", sequence=numbers)),
        (Times("time", spans), rr.TimeColumn("time", duration=spans)),
    ):
        assert ours.timeline_name() == theirs.timeline_name()
        assert ours.as_arrow_array().equals(theirs.as_arrow_array())
        assert ours.as_arrow_array().type == theirs.as_arrow_array().type
