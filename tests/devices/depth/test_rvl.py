from pathlib import Path
from uuid import uuid4

import numpy as np
import pytest
import rerun as rr
import rerun.blueprint as rrb
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import array_shapes, arrays
from numpy.typing import NDArray

from devices.depth.rvl import MEDIA_TYPE, decode_depth, encode_depth
from devices.sensor import DeviceError
from tests.helpers.pictures import colors_of_view, headless_viewer
from tests.helpers.waiting import eventually


def wall(height: int = 576, width: int = 640) -> NDArray[np.uint16]:
    """A slanted wall with 2 mm noise, a missing stripe and missing pixels."""
    rng = np.random.default_rng(0)
    y, x = np.mgrid[:height, :width]
    depth = (1500 + 1.5 * x + y + rng.normal(0, 2, x.shape)).astype(np.uint16)
    depth[:, : width // 8] = 0
    depth[rng.random(depth.shape) < 0.02] = 0
    return depth


@given(
    arrays(np.uint16, array_shapes(min_dims=2, max_dims=2, max_side=40))
    | arrays(np.uint16, (20, 30), elements=st.sampled_from([0, 0, 1, 65535, 32768]))
)
def test_nothing_is_lost(depth: NDArray[np.uint16]) -> None:
    np.testing.assert_array_equal(decode_depth(encode_depth(depth)), depth)


def test_a_depth_image_shrinks_to_less_than_half() -> None:
    assert len(encode_depth(wall())) < 0.5 * wall().nbytes


@given(st.binary(max_size=400), st.integers(0, 399), st.integers(0, 255))
def test_bytes_that_are_no_image_are_refused(junk: bytes, at: int, value: int) -> None:
    blob = bytearray(encode_depth(wall(24, 32)))
    blob[at % len(blob)] = value
    with pytest.raises(DeviceError, match="damaged"):
        decode_depth(encode_depth(wall(24, 32))[:-8])
    for bad in (junk, bytes(blob), bytes(blob[: at // 4 * 4])):
        try:
            assert decode_depth(bad).dtype == np.uint16
        except DeviceError as error:
            assert "depth image" in str(error)  # noqa: PT017


def test_the_viewer_draws_it(tmp_path: Path) -> None:
    picture = tmp_path / "depth.png"
    with headless_viewer() as viewer:
        stream = rr.RecordingStream("rvl", recording_id=uuid4())
        stream.connect_grpc(viewer.url)
        view = rrb.Spatial2DView(origin="/depth")
        stream.send_blueprint(rrb.Blueprint(view, collapse_panels=True), make_active=True)
        stream.log("depth", rr.EncodedDepthImage(encode_depth(wall()), media_type=MEDIA_TYPE, meter=1000.0))
        stream.flush()
        assert eventually(lambda: colors_of_view(viewer, view.id, picture) > 50)
        reports = [report for shown in viewer.get_state().views for report in shown.reports]
    assert reports == []
