"""Compilation before the first frame."""

from __future__ import annotations

import io
from collections.abc import Callable
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
    timers: list[Timer] = []

    class Timer:
        def __init__(self, seconds: float, function: Callable[..., object], arguments: list[Any]) -> None:
            self.seconds, self.running = seconds, False
            self.fire = lambda: function(*arguments)
            timers.append(self)

        def start(self) -> None:
            self.running = True

        def cancel(self) -> None:
            self.running = False

    def compile_all(*_: object) -> None:
        assert timers[0].running
        if long:
            timers[0].fire()

    monkeypatch.setattr(loop.threading, "Timer", Timer)
    monkeypatch.setattr(Fuser, "warm_up", compile_all)
    out = io.StringIO()
    loop.warm_up(Fuser(FusionSetup(nominal_calibration(KINECT_V1))), Console(file=out, width=120))
    assert ("Compiling" in out.getvalue()) == long
    assert timers[0].seconds == 1.0
    assert not timers[0].running
