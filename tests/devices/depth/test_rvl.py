import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import array_shapes, arrays

from devices.depth.rvl import decode_depth, encode_depth
from devices.sensor import DeviceError


def wall(height=576, width=640):
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
def test_nothing_is_lost(depth):
    np.testing.assert_array_equal(decode_depth(encode_depth(depth)), depth)


def test_a_depth_image_shrinks_to_less_than_half():
    assert len(encode_depth(wall())) < 0.5 * wall().nbytes


@given(st.binary(max_size=400), st.integers(0, 399), st.integers(0, 255))
def test_bytes_that_are_no_image_are_refused(junk, at, value):
    blob = bytearray(encode_depth(wall(24, 32)))
    blob[at % len(blob)] = value
    with pytest.raises(DeviceError, match="damaged"):
        decode_depth(encode_depth(wall(24, 32))[:-8])
    for bad in (junk, bytes(blob), bytes(blob[: at // 4 * 4])):
        try:
            assert decode_depth(bad).dtype == np.uint16
        except DeviceError as error:
            assert "depth image" in str(error)  # noqa: PT017
