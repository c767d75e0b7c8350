"""Short tones that tell the state of a set-up to a person who does not look at the screen."""

import shutil
import subprocess
import sys
import tempfile
import wave
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from types import TracebackType
from typing import Self

import numpy as np
from numpy.typing import NDArray

from recordings.appearance.state_card import TONES, State
from viewer_app.coach.readiness import Headline

RATE = 44_100
_PLAYERS = (("paplay",), ("pw-play",), ("aplay", "-q"), ("afplay",))
"""Programs of Linux and macOS that play a file."""
_LOUD, _FADE = 0.4, 0.01  # of the largest value; seconds, without which a tone begins with a click


def player() -> Callable[[Path], object] | None:
    """What plays a file in the background; None where this system has no program for it."""
    if sys.platform == "win32":
        import winsound

        how = winsound.SND_FILENAME | winsound.SND_ASYNC | winsound.SND_NODEFAULT
        return lambda path: winsound.PlaySound(str(path), how)
    for program, *options in _PLAYERS:
        if shutil.which(program):
            return partial(_play, [program, *options])
    return None


def _play(command: list[str], path: Path) -> None:
    subprocess.Popen(
        [*command, path], stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
    )


def sound_of(shown: Headline) -> str:
    """The name of a headline's sound in :data:`TONES`; empty where it has none."""
    if shown.lost:
        return "lost"
    return {State.NOT_YET: "not yet", State.READY: "ready"}.get(shown.state, "")


class Sounds:
    """Plays the sound of each new state and of each new thing to do. Use it as a context manager."""

    def __init__(self, play: Callable[[Path], object]) -> None:
        self._play = play
        self._last: tuple[State, str] | None = None
        self._folder = tempfile.TemporaryDirectory(prefix="duplex-", ignore_cleanup_errors=True)
        for name, tones in TONES.items():
            _write(self._path(name), _samples(tones))

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._folder.cleanup()

    def tell(self, shown: Headline) -> None:
        """Plays the headline's sound, if it is about something else than the last one."""
        about = shown.state, shown.kind
        if about != self._last:
            self._last = about
            if name := sound_of(shown):
                self._play(self._path(name))

    def _path(self, name: str) -> Path:
        return Path(self._folder.name) / f"{name.replace(' ', '_')}.wav"


def _samples(tones: Sequence[tuple[float, float]]) -> NDArray[np.int16]:
    parts = []
    for hertz, seconds in tones:
        time = np.arange(round(seconds * RATE)) / RATE
        fade = np.clip(np.minimum(time, seconds - time) / _FADE, 0.0, 1.0)
        parts.append(_LOUD * fade * np.sin(2.0 * np.pi * hertz * time))
    return (np.concatenate(parts) * np.iinfo(np.int16).max).astype("<i2")


def _write(path: Path, samples: NDArray[np.int16]) -> None:
    with wave.open(str(path), "wb") as file:
        file.setnchannels(1)
        file.setsampwidth(2)
        file.setframerate(RATE)
        file.writeframes(samples.tobytes())
