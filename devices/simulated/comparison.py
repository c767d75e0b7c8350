"""The simulator held against real sensors: the same figures, real beside simulated."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass

import numpy as np

from devices.simulated.realism import PairStatistics, statistics
from devices.simulated.sensor import PERSON, simulated_pair
from devices.simulated.tracker_errors import TrackerErrors
from fusion.body import AZURE_KINECT, KINECT_V2, Body
from fusion.skeleton import Skeleton

TUNING_SEEDS = range(1000, 1020)
"""The seeds that the defaults of TrackerErrors were fitted on. No accuracy is reported on these."""


@dataclass(frozen=True)
class Setting:
    """A simulated recording like a real one: the movement, and how it was watched."""

    motion: str
    body: Body
    angle_deg: float
    seconds: float


COUNTERPARTS = {
    "kinect_v2_90deg_stationary": Setting("still", KINECT_V2, 90.0, 8.0),
    "kinect_v2_90deg_steps": Setting("steps", KINECT_V2, 90.0, 24.0),
    "kinect_v2_90deg_walk": Setting("walk", KINECT_V2, 90.0, 30.0),
    "azure_squat": Setting("squat", AZURE_KINECT, 45.0, 24.0),
}
"""Which setting each real recording is compared with, by the recording's name."""

AZURE_SQUAT = {
    "view_median": (0.025, 0.025),
    "view_rms": (0.048, 0.048),
    "bone_deviation": (0.006, 0.027),
    "bone_deviation_share": (0.025, 0.065),
    "inferred": (0.025, 0.025),
    "not_tracked": (0.05, 0.05),
    "hands_unsure": (0.13, 0.77),
    "feet_unsure": (0.15, 0.15),
    "tracked_change": (0.008, 0.015),
    "tracked_change_p99": (0.057, 0.204),
    "inferred_change": (0.018, 0.049),
    "inferred_change_p99": (0.155, 0.817),
    "stale": (0.03, 0.10),
}
"""What 87 real trials of squats before two Azure Kinects, 38 to 54 degrees apart, showed: the range over
the trials, or one figure for all. The recordings themselves are not at hand."""

_UNITS = {"bone_deviation_share": "%", "swap_frames": "frames"}
_SHARES = ("inferred", "not_tracked", "hands_unsure", "feet_unsure", "swapped", "stale")


@dataclass(frozen=True)
class Figure:
    """One statistic, real beside simulated, in SI.

    Attributes:
        name: As in PairStatistics; ``jitter_<kind>`` for jitter.
        low, high: The real figure: a range, or twice the same.
        simulated: The simulated one.
    """

    name: str
    low: float
    high: float
    simulated: float

    @property
    def ratio(self) -> float:
        """Simulated to real, to the nearer end of a range; 1 within it; NaN where either says nothing."""
        nearest = min(max(self.simulated, self.low), self.high)
        return self.simulated / nearest if nearest > 0.0 else float("nan")

    def within(self, factor: float) -> bool:
        """Whether the simulated figure is the real one within a factor."""
        return bool(1.0 / factor <= self.ratio <= factor)

    @property
    def unit(self) -> str:
        """What it is printed in: mm, %, or frames."""
        return _UNITS.get(self.name, "%" if self.name in _SHARES else "mm")

    def printed(self) -> tuple[str, str, str, str]:
        """Name, real, simulated and ratio as text, in the unit."""
        scale = {"mm": 1e3, "%": 1e2, "frames": 1.0}[self.unit]
        real = f"{self.low * scale:.1f}"
        if self.high != self.low:
            real += f"–{self.high * scale:.1f}"
        name = f"{self.name.replace('_', ' ')} ({self.unit})"
        return name, real, f"{self.simulated * scale:.1f}", f"{self.ratio:.2f}"


def figures(real: PairStatistics, simulated: PairStatistics, *, standing: bool) -> list[Figure]:
    """Real beside simulated, without the figures that the real recording does not tell.

    Args:
        real: Of a recording.
        simulated: Of its counterpart.
        standing: Whether the person stands still: only then is jitter one of the figures.
    """
    pairs = {
        name: (value, getattr(simulated, name)) for name, value in asdict(real).items() if name != "jitter"
    }
    if standing:
        pairs |= {f"jitter_{kind}": (value, simulated.jitter[kind]) for kind, value in real.jitter.items()}
    return [
        Figure(name, r, r, s)
        for name, (r, s) in pairs.items()
        if np.isfinite(r) and r > 0.0 and np.isfinite(s)
    ]


def azure_figures(simulated: PairStatistics) -> list[Figure]:
    """The simulated squat beside the published figures of the real ones."""
    return [Figure(name, low, high, getattr(simulated, name)) for name, (low, high) in AZURE_SQUAT.items()]


def simulated_statistics(
    setting: Setting, seeds: Iterable[int] = TUNING_SEEDS, errors: TrackerErrors | None = None
) -> PairStatistics:
    """The figures of a simulated recording, each the median over the seeds.

    Args:
        setting: What is simulated; the start-up pose is left out.
        seeds: One recording each.
        errors: Of the trackers; the body's own where None.
    """
    found = []
    for seed in seeds:
        a, b, truth = simulated_pair(
            motion=setting.motion,
            body=setting.body,
            angle_deg=setting.angle_deg,
            seconds=setting.seconds,
            seed=seed,
            errors=errors,
        )
        skip = int(np.ceil(getattr(truth.scene.motion, "begins", 0.0) / truth.rig.frame_seconds))
        views: list[Sequence[Skeleton | None]] = [
            [frame.people.get(PERSON) for frame in sensor.frames()][skip:] for sensor in (a, b)
        ]
        found.append(asdict(statistics(*views)))
    jitter = {kind: _median([one["jitter"][kind] for one in found]) for kind in found[0]["jitter"]}
    others = {name: _median([one[name] for one in found]) for name in found[0] if name != "jitter"}
    return PairStatistics(jitter=jitter, **others)


def _median(values: list[float]) -> float:
    known = [value for value in values if np.isfinite(value)]
    return float(np.median(known)) if known else float("nan")
