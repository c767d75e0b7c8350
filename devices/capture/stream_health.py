"""What a live sensor's stream lacks: moments (silence, losses) and images of its moments, with the words."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator

from devices.capture.causes import Cause
from devices.capture.clock.moments import Incomplete, Moment
from devices.capture.frame_decimation import FrameDecimation
from devices.capture.settings import CaptureSettings
from devices.sensor import Sensor

_QUEUE = 3  # frames that an SDK's queue holds at least, of seven captures; half may be colour alone
_UNKNOWN_S = 2.0  # of a longer gap nothing is counted: it is told as a silence
_PARTS_S = 1.0  # images without depth so long ago no longer come: the last capture was cut off
_HALF_S = 0.8  # an image's absence is judged over two of these
_MANY, _FEW = 0.25, 0.05  # shares of the moments that lack an image


class Silence:
    """How long no moment has come, in time that was spent waiting for one.

    Attributes:
        seconds: That time; 0 where moments come.
    """

    def __init__(self, label: str, settings: CaptureSettings) -> None:
        self._label, self._settings, self.seconds = label, settings, 0.0
        self._started = False  # whether an image came at all
        self._part_s: float | None = None  # of this silence, when the last image without depth came

    @property
    def waits_for(self) -> str:
        """What a sensor without images waits for, where that is known; else empty."""
        waits = self.seconds > 0.0 and not self._started and self._settings.sync == "subordinate"
        return "the pulses of its master on the sync cable" if waits else ""

    def ends(self) -> None:
        """A moment came."""
        self.seconds, self._started, self._part_s = 0.0, True, None

    def lasts(self, seconds: float, came: Incomplete, advice: str) -> None:
        """No moment came.

        Args:
            advice: What to check if a subordinate gets no pulses.

        Raises:
            DeviceError: For too long.
        """
        self.seconds += seconds
        if came is Incomplete.PART:
            self._started, self._part_s = True, self.seconds
        parts = self._part_s is not None and self.seconds - self._part_s < _PARTS_S
        subordinate = self._settings.sync == "subordinate" and not parts
        waits_s = self._settings.stall_s if self._started else self._settings.start_s
        if self.seconds < (waits_s if subordinate else self._settings.stall_s):
            return
        if parts and self._settings.color is not None:
            raise Cause.ONLY_COLOR.error(label=self._label, seconds=self.seconds)
        cause = Cause.NO_PULSES if subordinate else Cause.NO_DEPTH
        raise cause.error(label=self._label, seconds=self.seconds, advice=advice)


class Losses:
    """Counts, in a sensor's figures, the moments that never came, by the gaps in their times.

    Those that never reached the SDK's queue, though it was emptied in time, are lost. Wanted ones that were
    dropped because the reader was too slow are missed. Those before the first one given are not counted.

    Attributes:
        gave: Whether the reader has had a moment, and has not been away for long since.
    """

    def __init__(self, counts: Sensor, fps: float, decimation: FrameDecimation) -> None:
        self._counts, self._fps, self._decimation = counts, fps, decimation
        self._last_ns: int | None = None
        self._away_ns = 0  # the longest time without a poll since the last moment
        self.gave = False

    def away(self, away_ns: int) -> None:
        """Nobody polled for so long."""
        self._away_ns = max(self._away_ns, away_ns)
        self.gave = self.gave and away_ns <= _UNKNOWN_S * 1e9

    def drop(self, count: int) -> None:
        """So many moments are dropped."""
        self._counts.missed += count * self.gave

    def count(self, moment: Moment, number: int) -> None:
        """Counts the moments before this one, whose ``number`` is the decimation's."""
        last_ns, self._last_ns = self._last_ns, moment.time_ns
        away_ns, self._away_ns = max(self._away_ns, moment.waited_ns), 0
        if last_ns is None or not self.gave:
            return
        gap = round((moment.time_ns - last_ns) * self._fps / 1e9) - 1  # below 0 where its clock starts anew
        if not 0 < gap < _UNKNOWN_S * self._fps:
            return
        if away_ns * self._fps < _QUEUE * 1e9:
            self._counts.lost += gap
        else:
            self._counts.missed += self._decimation.kept_before(number, gap)


class ImageHealth:
    """Whether an image comes with the moments: told within three seconds of a change.

    Args:
        image: ``color`` or ``infrared``.
        needed: Whether people are found in it.
    """

    def __init__(self, label: str, image: str, settings: CaptureSettings, needed: bool) -> None:
        self.image, self._label, self._settings, self._needed = image, label, settings, needed
        self._half = max(2, round(_HALF_S * settings.fps))
        self._lacks: deque[bool] = deque(maxlen=2 * self._half)
        self._count, self._told = 0, ""

    def told(self, lacks: bool, late_ns: int) -> Iterator[str]:
        """What to tell, given whether the next moment lacks the image, and by how much it comes too late."""
        self._lacks.append(lacks)
        self._count += 1
        if self._count % self._half or len(self._lacks) < 2 * self._half:
            return
        seen = list(self._lacks)
        first, second = (sum(half) / self._half for half in (seen[: self._half], seen[self._half :]))
        if first == second == 1.0:
            state = "late" if late_ns else "none"
        elif min(first, second) >= _MANY and max(first, second) < 1.0:
            state = "few"
        elif max(first, second) <= _FEW:
            state = ""
        else:
            return  # it changes now
        if state != self._told:
            self._told = state
            yield self._words(state, (1.0 - second) * self._settings.fps, late_ns)

    def _words(self, state: str, rate: float, late_ns: int) -> str:
        name = {"color": "colour"}.get(self.image, self.image)
        fields = {"label": self._label, "image": name, "rate": rate, "fps": self._settings.fps}
        if not state:
            return f"{self._label} gives all {name} images again."
        found = " No one is found without them." if self._needed else ""
        asked = self.image == "color" and self._settings.color is not None
        without = ", or run it without `color`" if asked else ""
        why = "Its room is too dark: make it brighter" if self.image == "color" else "USB loses them"
        if state == "few":
            return Cause.FEW_IMAGES.says(**fields, why=why, found=found, without=without)
        cause = Cause.LATE_IMAGES if state == "late" else Cause.NO_IMAGES
        return cause.says(**fields, late_ms=late_ns / 1e6, found=found, without=without)
