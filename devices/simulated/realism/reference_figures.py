"""Compares the simulator with real sensors: the same statistics, real and simulated."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import asdict, dataclass, replace

import numpy as np

from devices.simulated.kinect import PERSON, simulated_pair
from devices.simulated.realism.pair_statistics import PairStatistics, statistics
from devices.simulated.tracking.tracker_errors import TrackerErrors
from fusion.body import AZURE_KINECT, KINECT_V2, Body
from fusion.skeleton import Skeleton

TUNING_SEEDS = range(1000, 1020)
"""The seeds to which the defaults of TrackerErrors were fitted. No accuracy is reported on these seeds."""


@dataclass(frozen=True)
class Setting:
    """The movement and the set-up of a simulated recording that corresponds to a real one.

    Attributes:
        motion: Name of the movement.
        body: Body that the trackers report.
        angle_deg: Angle between the sensors, degrees.
        seconds: Duration.
        standing: Share of that time in which the person stands between the sensors and faces them.
    """

    motion: str
    body: Body
    angle_deg: float
    seconds: float
    standing: float = 0.0


COUNTERPARTS = {
    "kinect_v2_90deg_stationary": Setting("still", KINECT_V2, 90.0, 8.0),
    "kinect_v2_90deg_steps": Setting("steps", KINECT_V2, 90.0, 24.0),
    "kinect_v2_90deg_walk": Setting("walk", KINECT_V2, 90.0, 30.0, standing=0.4),
    "azure_squat": Setting("squat", AZURE_KINECT, 45.0, 24.0),
}
"""The setting that each real recording is compared with, by its name. On seven real walks the trunk is
slower than 0.2 m/s in 30 to 48 % of the frames (mean 41 %), in which the person faces the sensors."""

PUBLISHED: dict[str, dict[str, tuple[float, float]]] = {
    "kinect_v2_90deg_stationary": {
        "view_rms": (0.099, 0.099),
        "jitter_spine": (0.0005, 0.0008),
        "jitter_girdle": (0.0015, 0.002),
        "jitter_knee": (0.002, 0.002),
        "jitter_elbow": (0.003, 0.003),
        "jitter_wrist": (0.004, 0.005),
        "jitter_hand": (0.008, 0.008),
        "jitter_tip": (0.007, 0.011),
        "jitter_thumb": (0.015, 0.020),
        "stale": (0.03, 0.10),
    },
    "kinect_v2_90deg_steps": {"view_rms": (0.140, 0.140), "stale": (0.03, 0.10)},
    "kinect_v2_90deg_walk": {"view_rms": (0.192, 0.192), "swapped": (0.076, 0.076), "stale": (0.03, 0.10)},
    "azure_squat": {
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
    },
}
"""Figures of many real recordings by setting: the range over trials or joints, or one figure for all.
The squats are 87 trials with two Azure Kinects, 38 to 54 degrees apart. The others are with Kinects v2, 90
degrees apart. Most of these recordings are not available to this project."""

_FITTED = "the simulator is fitted to the one recording at hand"
REASONS = {
    ("kinect_v2_90deg_steps", "view_rms"): f"{_FITTED}, whose views differ by less than most do",
    ("kinect_v2_90deg_stationary", "jitter_spine"): f"{_FITTED}, whose spine trembles more than most do",
    ("kinect_v2_90deg_walk", "swapped"): f"{_FITTED}, with more than the mean; the worst trial had 16 %",
}
"""Reasons why the simulator does not reproduce a published figure, by setting and figure."""

_UNITS = {"bone_deviation_share": "%", "swap_frames": "frames"}
_ABSENT = {"%": 0.01, "mm": 0.001, "frames": 1.0}
"""Largest simulated value if the real value is 0, by unit (SI)."""
_OF_STATES = (
    "inferred",
    "not_tracked",
    "hands_unsure",
    "feet_unsure",
    "inferred_change",
    "inferred_change_p99",
)
_SHARES = ("inferred", "not_tracked", "hands_unsure", "feet_unsure", "swapped", "stale")


@dataclass(frozen=True)
class Figure:
    """A real and a simulated value of one statistic, in SI.

    Attributes:
        name: As in PairStatistics; ``jitter_<kind>`` for jitter.
        low, high: Range of the real value; equal for a single value, NaN if unknown.
        simulated: The simulated value; NaN if there is none.
        reason: Reason why there is no ratio, or why it is far from 1; may be empty.
    """

    name: str
    low: float
    high: float
    simulated: float
    reason: str = ""

    @property
    def known(self) -> bool:
        """Whether both values are known."""
        return bool(np.isfinite([self.low, self.high, self.simulated]).all())

    @property
    def ratio(self) -> float:
        """Simulated value divided by the nearer end of the real range; 1 within the range; NaN if unknown."""
        nearest = min(max(self.simulated, self.low), self.high)
        return self.simulated / nearest if self.known and nearest > 0.0 else float("nan")

    @property
    def limit(self) -> float:
        """Largest simulated value if the real value is 0."""
        return _ABSENT[self.unit]

    def within(self, factor: float) -> bool:
        """Whether the values agree within a factor; if the real value is 0, whether the limit is kept."""
        if self.known and self.high == 0.0:
            return self.simulated <= self.limit
        return bool(1.0 / factor <= self.ratio <= factor)

    @property
    def unit(self) -> str:
        """Unit for printing: mm, % or frames."""
        return _UNITS.get(self.name, "%" if self.name in _SHARES else "mm")

    def printed(self) -> tuple[str, str, str, str]:
        """Name, real, simulated and ratio as text, in the unit; "–" for an unknown value."""
        scale = {"mm": 1e3, "%": 1e2, "frames": 1.0}[self.unit]
        real = _text(self.low * scale, 1)
        if self.high != self.low and self.known:
            real += f"–{self.high * scale:.1f}"
        name = f"{self.name.replace('_', ' ')} ({self.unit})"
        return name, real, _text(self.simulated * scale, 1), _text(self.ratio, 2)


def _text(value: float, digits: int) -> str:
    return f"{value:.{digits}f}" if np.isfinite(value) else "–"


def figures(real: PairStatistics, simulated: PairStatistics, *, standing: bool) -> list[Figure]:
    """Pairs real with simulated statistics; a statistic that one of them lacks states the reason.

    Args:
        real: Statistics of a recording.
        simulated: Statistics of its simulated counterpart.
        standing: Whether the person stands still; otherwise jitter is left out.
    """
    pairs = {
        name: (value, getattr(simulated, name)) for name, value in asdict(real).items() if name != "jitter"
    }
    if standing:
        pairs |= {f"jitter_{kind}": (value, simulated.jitter[kind]) for kind, value in real.jitter.items()}
    stateless = real.inferred == real.not_tracked == 0.0
    return [_beside(name, r, s, stateless and name in _OF_STATES) for name, (r, s) in pairs.items()]


def _beside(name: str, real: float, simulated: float, stateless: bool) -> Figure:
    if stateless:
        real, reason = float("nan"), "the recording calls every joint tracked"
    elif not np.isfinite(real):
        reason = "the recording has no such frames"
    elif not np.isfinite(simulated):
        reason = "the simulation has no such frames"
    else:
        reason = ""
    figure = Figure(name, real, real, simulated, reason)
    if real != 0.0:
        return figure
    _, _, limit, _ = replace(figure, simulated=figure.limit).printed()
    return replace(figure, reason=f"the recording has none; simulated at most {limit} {figure.unit}")


def published_figures(name: str, simulated: PairStatistics) -> list[Figure]:
    """Pairs the statistics of a simulated setting, by its name, with published figures."""
    found = asdict(simulated) | {f"jitter_{kind}": value for kind, value in simulated.jitter.items()}
    return [
        Figure(figure, low, high, found[figure], REASONS.get((name, figure), ""))
        for figure, (low, high) in PUBLISHED[name].items()
    ]


def simulated_statistics(
    setting: Setting, seeds: Iterable[int] = TUNING_SEEDS, errors: TrackerErrors | None = None
) -> PairStatistics:
    """Computes the statistics of a simulated setting, each the median over the seeds.

    Args:
        setting: The setting; its start-up pose is left out.
        seeds: Seeds, one recording each.
        errors: Errors of the trackers; None: those of the body.
    """
    found = []
    for seed in seeds:
        views: list[list[Skeleton | None]] = [[], []]
        for motion, share in ((setting.motion, 1.0 - setting.standing), ("idle", setting.standing)):
            if share > 0.0:
                for view, more in zip(views, _reported(setting, motion, share, seed, errors), strict=True):
                    view += more
        found.append(asdict(statistics(*views)))
    jitter = {kind: _median([one["jitter"][kind] for one in found]) for kind in found[0]["jitter"]}
    others = {name: _median([one[name] for one in found]) for name in found[0] if name != "jitter"}
    return PairStatistics(jitter=jitter, **others)


def _reported(
    setting: Setting, motion: str, share: float, seed: int, errors: TrackerErrors | None
) -> list[list[Skeleton | None]]:
    """Returns both views of a movement that takes a share of the time, without the start-up pose."""
    a, b, truth = simulated_pair(
        motion=motion,
        body=setting.body,
        angle_deg=setting.angle_deg,
        seconds=share * setting.seconds,
        seed=seed,
        errors=errors,
    )
    skip = int(np.ceil(getattr(truth.scene.motion, "begins", 0.0) / truth.rig.frame_seconds))
    return [[frame.people.get(PERSON) for frame in sensor.frames()][skip:] for sensor in (a, b)]


def _median(values: list[float]) -> float:
    known = [value for value in values if np.isfinite(value)]
    return float(np.median(known)) if known else float("nan")
