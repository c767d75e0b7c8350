"""What this program uses of libfreenect, held against the real library and its player fakenect."""

import ctypes
import shutil

import pytest

from devices.freenect import libfreenect
from devices.freenect.libfreenect import Context
from devices.freenect.sensor import VENDOR
from devices.sensor import AbsentError
from tests.helpers.freenect import typed


def test_the_real_library_has_every_function_and_fakenect_all_but_the_list(real_freenect, fakenect, tmp_path):
    assert typed(real_freenect) == []
    copy = ctypes.CDLL(shutil.copy(fakenect._file, tmp_path / "copy.so"))
    assert typed(copy) == ["freenect_list_device_attributes", "freenect_free_device_attributes"]


def test_our_context_of_the_real_library(real_freenect):
    assert libfreenect.load_library() is real_freenect
    with Context() as context:
        assert (context.serials(), context.count()) == ([], 0)
        assert context.process(0.001)
        with pytest.raises(AbsentError, match=r"No Kinect v1 with serial A0036\. No other is connected\."):
            context.open("A0036")
    assert libfreenect.connected_freenects() == []
    assert VENDOR.sdk_check().ok
