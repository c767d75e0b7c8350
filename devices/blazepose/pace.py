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
    If that lasts, both change to the network ``lite`` for good, and get every frame again if it is fast
    enough. Share it between both sensors' ``TrackedImages``, between the sensors themselves, and
    ``TwoSensors``.

    Attributes:
        simulated: Whether the sensors are simulated, so that there is nothing to record.
    """

    def __init__(
        self,
        fps: float,
        settings: BlazePoseSettings | None = None,
        clock: Callable[[], int] = time.perf_counter_ns,
        *,
        simulated: bool = False,
    ) -> None:
        super().__init__(fps, clock)
        settings = settings or BlazePoseSettings()
        self.settings, self._simulated = settings, simulated
        self._network: NetworkName = settings.network
        folder = settings.models or cache_folder()
        wants_lighter, lacks_lite = settings.network == "full", bool(missing("lite", folder))
        self._has_lighter = wants_lighter and not lacks_lite
        self._fetch_lighter = fetch_command("lite", folder) if wants_lighter and lacks_lite else ""
        self._slow_ns: int | None = None  # since when fewer frames are needed
        self._news: list[str] = []

    @property
    def network(self) -> NetworkName:
        """The landmark network that both trackers are to use."""
        return self._network

    @property
    def advice(self) -> str:
        lighter = f"Or get its faster network: {self._fetch_lighter}. " if self._fetch_lighter else ""
        later = "" if self._simulated else "Or record now and track later (duplex fuse a.mkv b.mkv)."
        text = f"It is the tracker, which needs a faster processor, not USB or light. {lighter}{later}"
        return text.rstrip()

    def _chosen(self, now_ns: int) -> None:
        slow = self.step > 1 and self.choice.easy_ns is None
        self._slow_ns = (self._slow_ns or now_ns) if slow else None
        lasts = self._slow_ns is not None and now_ns - self._slow_ns >= _PATIENCE_NS
        if self._has_lighter and (self.choice.taken_back or lasts):
            self._has_lighter = False
            self._network = "lite"
            self.choice.learn_anew()
            self._news.append(
                "The body tracker goes on with its network lite, which is faster and less accurate than full."
            )

    def stay(self, network: NetworkName, why: DeviceError) -> None:
        """Goes on with the network that a tracker has, because the other one cannot be loaded."""
        self._network = network
        self._news.append(f"{why} The body tracker goes on with its network {network}.")

    def take_news(self) -> list[str]:
        """Changes other than the decimation, one line each. Each is reported once."""
        news, self._news = self._news, []
        return news
