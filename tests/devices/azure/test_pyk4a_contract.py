"""The stand-in for pyk4a and the real library, without hardware, held to the same clauses."""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from devices.azure.calibration import depth_intrinsics
from devices.azure.mkv import MkvRecording
from tests.helpers import pyk4a_contract
from tests.helpers.pyk4a_contract import CLAUSES, CRASHES
from tests.helpers.standin_pyk4a import Bus, WouldCrashError
from tests.helpers.standin_values import color_calibration

Clause = Callable[[object, str], object]
NAMES = [clause.__name__ for clause in CLAUSES]


def _standin(bus: Bus, clause: Clause, recording: Path) -> dict[str, object]:
    assert bus.devices == []
    try:
        return {"said": clause(sys.modules["pyk4a"], str(recording))}
    except WouldCrashError:
        return {"fault": CRASHES}


@pytest.fixture
def recording(shared: Path) -> Path:
    return shared / "azure" / "recording.mkv"


@pytest.mark.parametrize("clause", CLAUSES, ids=NAMES)
def test_the_standin_keeps_the_contract(bus: Bus, recording: Path, clause: Clause) -> None:
    fault = _standin(bus, clause, recording).get("fault")
    assert fault == (CRASHES if clause is pyk4a_contract.stop_before_open else None)


@pytest.mark.parametrize("clause", CLAUSES, ids=NAMES)
def test_the_real_library_keeps_it_and_says_the_same(
    bus: Bus, recording: Path, real_pyk4a: dict[str, dict[str, object]], clause: Clause
) -> None:
    real, standin = real_pyk4a[clause.__name__], _standin(bus, clause, recording)
    assert real.get("fault") == standin.get("fault")
    if clause is not pyk4a_contract.calibration:
        assert real.get("said") == standin.get("said")


@pytest.mark.parametrize("depth", pyk4a_contract.DEPTH)
@pytest.mark.parametrize("color", pyk4a_contract.COLOR)
def test_our_calibration_is_the_real_librarys_in_every_mode(
    recording: Path, real_pyk4a: dict[str, dict[str, object]], depth: str, color: str
) -> None:
    with MkvRecording(recording) as opened:
        assert opened.info is not None
        text = opened.info.calibration_json
    color_lens, place = color_calibration(text, color)
    found = real_pyk4a["calibration"]["said"][f"{depth} {color}"]  # type: ignore[index]
    for lens, values in ((depth_intrinsics(text, depth), found[0]), (color_lens, found[1])):
        (fx, _, cx, _, fy, cy), distortion = values[:6], values[9:]
        # libk4a computes in single precision: 24 bits of a focal length of up to 4096 px, a few steps
        assert np.allclose([lens.fx, lens.fy, lens.cx, lens.cy], [fx, fy, cx, cy], rtol=0, atol=2e-3)
        assert np.allclose(lens.distortion, distortion, rtol=1e-6, atol=0)
    assert np.allclose(place.rotation.ravel(), found[2], rtol=0, atol=1e-6)
    assert np.allclose(place.translation, found[3], rtol=0, atol=1e-8)
