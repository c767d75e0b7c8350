"""Compilation before the first frame."""

from __future__ import annotations

import io
import threading
from typing import Any

import pytest
from rich.console import Console

from fusion.body import KINECT_V1
from fusion.calibration.calibration import nominal_calibration
from fusion.fuser import Fuser
from fusion.setup import FusionSetup
from viewer_app.running import loop


@pytest.mark.parametrize("long", [True, False])
def test_compiling_that_takes_its_time_is_announced(long: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    printed = threading.Event()

    class Told(Console):
        def print(self, *objects: Any, **options: Any) -> None:
            super().print(*objects, **options)
            printed.set()

    # a warm-up that is not long ends before the notice is due
    monkeypatch.setattr(Fuser, "warm_up", lambda *_: printed.wait(30.0) if long else None)
    out = io.StringIO()
    loop.warm_up(Fuser(FusionSetup(nominal_calibration(KINECT_V1))), Told(file=out, width=120))
    assert ("Compiling" in out.getvalue()) == long
    assert printed.wait(0.0 if long else 1.2) == long
