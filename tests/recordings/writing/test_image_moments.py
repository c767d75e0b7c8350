"""A viewer gets each image with the skeleton of its own moment, and no old point clouds."""

from dataclasses import replace

import pytest
import rerun as rr
from hypothesis import given
from hypothesis import strategies as st

from devices.depth.image_thinning import without_images
from recordings import layout
from recordings.file.rrd_file import RrdFile
from recordings.writing.recorder import Recorder
from tests.helpers.live_frames import frames, known_fuser
from tests.helpers.two_views import FRAME_NS

LEFT_OUT = st.lists(st.sampled_from(["", "a", "b", "ab"]), min_size=8, max_size=8)
OLD = 8  # frames, a quarter of a second


@pytest.fixture(scope="module")
def made():
    """A second of frames with images, of a fuser."""
    fuser = known_fuser()
    return fuser, frames(fuser, 30, depth=True)


def shown(path, fuser, given_frames, block):
    """What a viewer gets: by entity, frame numbers and the values of one component."""
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
            if "frame" in batch.schema.names and "Points3D:positions" in batch.schema.names:
                numbers, values = (batch.column(name).to_pylist() for name in ("frame", "Points3D:positions"))
                found.setdefault(entity, {}).update(zip(numbers, values, strict=True))
    return found


@given(LEFT_OUT, st.sampled_from([1, 3]))
def test_the_skeleton_of_an_image_is_that_of_its_frame(made, tmp_path_factory, left_out, block):
    fuser, all_frames = made
    some = [
        replace(each, pair=without_images(each.pair, of))
        for each, of in zip(all_frames, left_out, strict=False)
    ]
    found = shown(tmp_path_factory.mktemp("s") / "s.rrd", fuser, some, block)
    for side in layout.SIDES:
        of_images = found.get(layout.image_skeleton(side), {})
        every = found[layout.skeleton(side)]
        assert set(of_images) == {k for k, of in enumerate(left_out) if side not in of}
        assert all(of_images[k] == every[k] for k in of_images)


@pytest.mark.parametrize("without", [OLD - 2, OLD + 4])
def test_a_point_cloud_goes_a_quarter_of_a_second_after_its_image(made, tmp_path, without):
    fuser, all_frames = made
    some = [
        replace(each, pair=without_images(each.pair)) if 1 <= k <= without else each
        for k, each in enumerate(all_frames[: without + 2])
    ]
    clouds = shown(tmp_path / "s.rrd", fuser, some, 1)[layout.points("a")]
    gone = {number for number, points in clouds.items() if not points}
    assert gone == ({k for k in [250_000_000 // FRAME_NS + 1] if k <= without})
    assert clouds[without + 1]
