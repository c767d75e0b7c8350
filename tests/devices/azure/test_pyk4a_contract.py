"""The stand-in for pyk4a and the real library, without hardware, held to the same clauses."""

import sys

import numpy as np
import pytest

from devices.azure.calibration import depth_intrinsics
from devices.azure.mkv import MkvRecording
from tests.helpers import pyk4a_contract
from tests.helpers.pyk4a_contract import CLAUSES, CRASHES, RECORDING_CLAUSES
from tests.helpers.standin_pyk4a import WouldCrashError

NAMES = [clause.__name__ for clause in CLAUSES]


def _standin(bus, clause, recording):
    assert bus.devices == []
    try:
        return {"said": clause(sys.modules["pyk4a"], str(recording))}
    except WouldCrashError:
        return {"fault": CRASHES}


@pytest.fixture
def recording(shared):
    return shared / "azure" / "recording.mkv"


@pytest.mark.parametrize("clause", CLAUSES, ids=NAMES)
def test_the_real_library_keeps_it_and_says_the_same(bus, recording, real_pyk4a, clause):
    real, standin = real_pyk4a[clause.__name__], _standin(bus, clause, recording)
    assert real == standin


def test_our_recording_is_the_real_librarys(recording, real_pyk4a):
    assert not any("fault" in real_pyk4a[clause.__name__] for clause in RECORDING_CLAUSES)
    with MkvRecording(recording) as opened:
        (frame,), info = opened.frames(), opened.info
    for name, image in (("depth", frame.depth), ("ir", frame.ir)):
        assert real_pyk4a["images"]["said"][name] == int(image.astype(np.int64).sum())
    assert real_pyk4a["times"]["said"] == {"depth_usec": frame.time_ns // 1000}
    assert real_pyk4a["configuration"]["said"] == {
        "camera_fps": [5, 15, 30].index(round(1e9 / info.interval_ns)),
        "subordinate_delay_off_master_usec": info.subordinate_delay_ns // 1000,
        "start_timestamp_offset_usec": info.start_offset_ns // 1000,
    }


@pytest.mark.parametrize("depth", pyk4a_contract.DEPTH)
def test_our_lens_is_the_real_librarys_in_every_mode(recording, real_pyk4a, depth):
    with MkvRecording(recording) as opened:
        lens = depth_intrinsics(opened.info.calibration_json, depth)
    (fx, _, cx, _, fy, cy, *_), distortion = np.split(real_pyk4a["calibration"]["said"][depth], [9])
    # libk4a computes in single precision: 24 bits of a focal length of up to 4096 px, a few steps
    assert np.allclose([lens.fx, lens.fy, lens.cx, lens.cy], [fx, fy, cx, cy], rtol=0, atol=2e-3)
    assert np.allclose(lens.distortion, distortion, rtol=1e-6, atol=0)
