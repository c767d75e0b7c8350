"""Keeps two trackers on one processor in time: first with fewer frames, then with the lighter network."""

import time
from collections.abc import Callable

from devices.blazepose.networks.files import cache_folder, fetch_command, missing
from devices.blazepose.settings import BlazePoseSettings, NetworkName
from devices.capture.frame_decimation import FrameDecimation
from devices.sensor import DeviceError

_PATIENCE_NS = 2_000_000_000
"""After so long with fewer frames than the cameras give, ``lite`` is used. A viewer that starts, or another
program, may slow the trackers for a moment. That costs frames, but no accuracy."""


class TrackingPace(FrameDecimation):
    """The moments that two trackers of this program work on, and the network that they use.

    Where a tracker is slower than the cameras, both sensors keep the same fewer frames, as with any tracker.
    If that lasts two seconds, or more frames were tried and were too many, both change to the network
    ``lite`` and stay with it, unless it cannot be loaded (:meth:`stay`). They get every frame again if it is
    fast enough. Share it between both sensors' ``TrackedImages``, between the sensors themselves, and
    ``TwoSensors``.

    Attributes:
        settings: The tracker's settings, with the network at the start.
        network: The landmark network that both trackers are to use.
    """

    def __init__(
        self,
        fps: float,
        settings: BlazePoseSettings,
        clock: Callable[[], int] = time.perf_counter_ns,
        *,
        simulated: bool = False,  # then there is nothing to record
    ) -> None:
        super().__init__(fps, clock)
        self.settings = settings
        self.network: NetworkName = settings.network
        folder, full = settings.models or cache_folder(), settings.network == "full"
        fetch = fetch_command("lite", folder) if full and missing("lite", folder) else ""
        lighter = f" Or get its faster network: {fetch}." if fetch else ""
        later = "" if simulated else " Or record now and track later (duplex fuse a.mkv b.mkv)."
        self.advice = f"It is the tracker, which needs a faster processor, not USB or light.{lighter}{later}"
        self._has_lighter = full and not fetch
        self._slow_ns: int | None = None  # since when fewer frames are needed
        self._news: list[str] = []

    def _chosen(self, now_ns: int) -> None:
        slow = self.step > 1 and self.choice.easy_ns is None
        self._slow_ns = (self._slow_ns or now_ns) if slow else None
        lasts = self._slow_ns is not None and now_ns - self._slow_ns >= _PATIENCE_NS
        if self._has_lighter and (self.choice.taken_back or lasts):
            self._has_lighter, self.network = False, "lite"
            self.choice.learn_anew()
            self._news.append(
                "The body tracker continues with its network lite, which is faster and less accurate than "
                "full."
            )

    def stay(self, network: NetworkName, why: DeviceError) -> None:
        """Goes on with the network that a tracker has, because the other one cannot be loaded."""
        self.network = network
        self._news.append(f"{why} The body tracker continues with its network {network}.")

    def take_news(self) -> list[str]:
        news, self._news = self._news, []
        return news
