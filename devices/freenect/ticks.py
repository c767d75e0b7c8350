"""The clock of a Kinect v1, which wraps."""

FPS = 30
TICKS_PER_S = 60_000_000
"""The clock's rate according to libfreenect's driver for OpenNI 2."""
_WRAP = 2**32  # ticks: 72 s


class TickCounter:
    """Ticks of the sensor's 32-bit clock without its wraps, by this machine's clock."""

    def __init__(self) -> None:
        self._last: tuple[int, int] | None = None

    def total(self, ticks: int, host_ns: int) -> int:
        """The count nearest to what this machine's clock predicts from the call before.

        Frames may be any time apart, and images of two cameras out of order by up to half a wrap.
        """
        total = ticks
        if self._last is not None:
            last, last_ns = self._last
            expected = last + (host_ns - last_ns) * TICKS_PER_S // 1_000_000_000
            total += _WRAP * round((expected - ticks) / _WRAP)
        self._last = total, host_ns
        return total
