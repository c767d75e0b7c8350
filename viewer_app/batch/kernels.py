"""Compiles the kernels once per machine: the first worker compiles, the others wait and load from disk."""

from __future__ import annotations

import io
import os
import tempfile
from collections.abc import Callable
from functools import cache
from pathlib import Path

from rich.console import Console

from devices.pairing import pair_recordings
from devices.simulated.kinect import PERSON, simulated_pair
from fusion.body import KINECT_V1
from fusion.fuser import Fuser
from fusion.plan import plan_recording
from fusion.setup import FuserSettings, Hindsight, Method
from recordings.fusing.pairs import fuse_segments, setups_of
from viewer_app.batch.machine_lock import one_process
from viewer_app.running.loop import warm_up

_SECONDS = 3.0
"""Duration of the recording that is fused: its start-up pose, which a calibration needs."""


def nobody(_: str) -> None:
    """Takes notices that nobody reads."""


@cache
def compile_once(method: Method, smooth: str, say: Callable[[str], object] = nobody) -> None:
    """Runs everything that fuses a recording, so that all kernels are compiled and loaded.

    Args:
        method: The method that will be used.
        smooth: The option ``--smooth``.
        say: Receives a notice if this takes more than a second.
    """
    hindsight: Hindsight = "none" if method != "duplex" else "whole" if smooth == "whole" else "labels"
    settings = FuserSettings(method, hindsight=hindsight)
    with one_process(Path(tempfile.gettempdir()) / f"duplex-kernels-{_user()}.lock"):
        a, b, _ = simulated_pair(motion="still", body=KINECT_V1, seconds=_SECONDS)
        pairs = pair_recordings(list(a.frames()), list(b.frames()), PERSON, PERSON).pairs
        plan = plan_recording(KINECT_V1, [pair.skeletons for pair in pairs], settings)
        segments = setups_of(plan, settings, (None, None))
        warm_up(Fuser(segments[0][0]), Console(file=_Lines(say)))
        for _ in fuse_segments(segments, pairs, plan.codes):
            pass


class _Lines(io.StringIO):
    """A file whose lines go to a function."""

    def __init__(self, say: Callable[[str], object]) -> None:
        super().__init__()
        self._say = say

    def write(self, text: str, /) -> int:
        if text.strip():
            self._say(text.strip())
        return len(text)


def _user() -> str:
    return str(os.getuid()) if hasattr(os, "getuid") else "user"
