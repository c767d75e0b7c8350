"""A viewer gets each image with the skeleton of its own moment, and none that is late."""

from dataclasses import replace

import numpy as np
import pytest
import rerun as rr
from hypothesis import given
from hypothesis import strategies as st

from devices.sensor import ColorCamera, ColorImage
from fusion.intrinsics import NOMINAL_INTRINSICS
from fusion.rigid import RigidTransform
from recordings.data import layout
from recordings.file.rrd_file import RrdFile
from recordings.writing.recorder import Recorder
from recordings.writing.shown_images import LATE_NS
from tests.helpers.live_frames import BODY, frames, known_fuser
from tests.helpers.two_views import FRAME_NS

COLOR = ColorImage(b"\xff\xd8\xff\xd9", ColorCamera(NOMINAL_INTRINSICS[BODY.name], RigidTransform.identity()))
FRAMES = 40
IMAGES = {"depth": ("DepthImage:buffer", layout.depth), "color": ("EncodedImage:blob", layout.color)}
STREAKS = st.lists(st.tuples(st.booleans(), st.integers(1, 14)), min_size=1, max_size=8)
"""Whether something is there, and for how many frames; repeated."""


@pytest.fixture(scope="module")
def made():
    """Frames with depth images, and the fuser that made them."""
    fuser = known_fuser()
    return fuser, frames(fuser, FRAMES, depth=True)


def there(streaks):
    return np.resize(np.repeat(*zip(*streaks, strict=True)), FRAMES)


def seen(sensor_frame, depth, color):
    return replace(sensor_frame, depth=sensor_frame.depth if depth else None, color=COLOR if color else None)


def messages(path, fuser, given_frames, block):
    """Frame numbers by entity and component, of all that a viewer gets."""
    stream = rr.RecordingStream(layout.APPLICATION_ID)
    stream.save(path)
    recorder = Recorder(stream, fuser.setup, ("a", "b"), depth_every=1, points=True)
    for k in range(0, len(given_frames), block):
        recorder.record_all(given_frames[k : k + block])
    stream.flush()
    stream.disconnect()
    found = {}
    with RrdFile(path) as file:
        for entity, batch in file.chunks(images=True):
            if "time" in batch.schema.names:
                times = batch.column("time").cast("int64").to_pylist()
                for name in batch.schema.names:
                    found.setdefault((entity, name), []).extend(times)
    return found


@given(st.lists(STREAKS, min_size=4, max_size=4), STREAKS, st.sampled_from([1, 4]))
def test_what_is_on_the_screen_is_of_one_moment(made, tmp_path_factory, images, kept, block):
    fuser, all_frames = made
    depth_a, color_a, depth_b, color_b = map(there, images)
    some = [
        replace(
            each,
            pair=replace(
                each.pair,
                a=seen(each.pair.a, depth_a[k], color_a[k]),
                b=seen(each.pair.b, depth_b[k], color_b[k]),
            ),
        )
        for k, each in enumerate(all_frames)
        if k == 0 or there(kept)[k]  # of the others, a slow viewer gets nothing
    ]
    found = messages(tmp_path_factory.mktemp("s") / "s.rrd", fuser, some, block)

    def latest(now_ns, *of):
        return max((at for at in found.get(of, []) if at <= now_ns), default=-1)

    for frame in some:
        now_ns = frame.pair.time_ns
        for side in layout.VIEWS:
            for kind, (component, entity) in IMAGES.items():
                cleared = latest(now_ns, entity(side), "Clear:is_recursive")
                image = latest(now_ns, entity(side), component)
                skeleton = latest(now_ns, layout.image_skeleton(side, kind), "Points3D:positions")
                if image > cleared:
                    assert skeleton == image
                    assert now_ns - image <= LATE_NS
                else:
                    assert skeleton == now_ns
            cleared = latest(now_ns, layout.points(side), "Clear:is_recursive")
            cloud = latest(now_ns, layout.points(side), "Points3D:positions")
            assert cloud <= cleared or now_ns - cloud <= LATE_NS


def test_an_image_stays_until_it_is_late(made, tmp_path):
    fuser, all_frames = made
    some = [replace(each, pair=replace(each.pair, a=seen(each.pair.a, k == 0, False)))
            for k, each in enumerate(all_frames)]  # fmt: skip
    found = messages(tmp_path / "s.rrd", fuser, some, 1)
    late = (LATE_NS // FRAME_NS + 1) * FRAME_NS
    assert found[layout.depth("a"), "Clear:is_recursive"] == [late]
    assert found[layout.image_skeleton("a", "depth"), "Points3D:positions"][:2] == [0, late]
