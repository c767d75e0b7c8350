"""Which view S* follows: joints coloured by their source, and one lane per limb over time."""

from functools import cache

import numpy as np
from numpy.typing import NDArray

from fusion.body import Body
from fusion.joint_kinds import ARM, LEG, kind_of, limbs
from fusion.skeleton import NO_FRAME
from recordings.appearance.colors import PREDICTED_COLOR, SKELETON_COLORS, Color
from recordings.data.session_arrays import SessionArrays

LIMBS = ("head", "left arm", "right arm", "trunk", "left leg", "right leg")
SOURCES = ("from A", "from B", "from both", "predicted")
SOURCE_COLORS: tuple[Color, ...] = (*(SKELETON_COLORS[key] for key in ("a", "b", "fused")), PREDICTED_COLOR)
"""By the indices of :data:`SOURCES`."""
_SHADES = 16  # finer shades are not visible; few colours compress well
_MOSTLY = 0.7  # share of a view from which on a limb counts as following it
_COLOR_SECONDS, _LIMB_SECONDS = 1.0, 0.316  # time constants of the running means
_NEWEST_NS = 200_000_000  # a frame of a sensor says nothing any more after this time


class SeenJoints:
    """Tells which joints a sensor saw in its newest frame.

    Sensors whose frames are not simultaneous give them in turn. Without the newest frame, a joint that one of
    them sees all the time would count as unseen in every frame of the other.
    """

    def __init__(self, joints: int) -> None:
        self._seen = np.zeros((1, joints), dtype=bool)
        self._time_ns = np.full(1, -(2**62), dtype=np.int64)

    def add(
        self, states: NDArray[np.integer], clock: NDArray[np.int64], time_ns: NDArray[np.int64]
    ) -> NDArray[np.bool_]:
        """(T, J) of frames in time order; after 0.2 s without a frame of the sensor no joint is seen."""
        seen = np.concatenate((self._seen, states != 0))
        times = np.concatenate((self._time_ns, time_ns))
        gave = np.concatenate(([True], clock != NO_FRAME))
        newest = np.maximum.accumulate(np.where(gave, np.arange(len(gave)), 0))
        self._seen, self._time_ns = seen[newest[-1:]], times[newest[-1:]]
        recent = times - times[newest] <= _NEWEST_NS
        return np.asarray((seen[newest] & recent[:, None])[1:])


class TrustColors:
    """Colours the joints of S* by the views that they followed in the last second.

    A frame that a sensor repeats has no weight. Without a mean, the whole body would take the other sensor's
    colour for that frame.
    """

    def __init__(self) -> None:
        self._mean = _RunningMean(_COLOR_SECONDS)
        self._sensors: tuple[SeenJoints, SeenJoints] | None = None

    def add(self, rows: SessionArrays) -> NDArray[np.uint8]:
        """(T, J, 3) RGB of frames in time order: the colours of A, of S* where both views count alike, and of
        B; grey where neither sensor sees the joint."""
        share = self.shares(rows)
        unseen = np.isnan(share)
        shades = np.where(unseen, _SHADES + 1, np.round(np.nan_to_num(share) * _SHADES)).astype(np.int64)
        return np.asarray(_palette()[shades])

    def shares(self, rows: SessionArrays) -> NDArray[np.float64]:
        """(T, J) share of A in frames in time order; NaN where neither sensor sees the joint."""
        weights = np.stack((rows.weights_a, rows.weights_b), axis=1).astype(np.float64)
        means = self._mean.add(weights, rows.time_ns)
        total = means.sum(axis=1)
        share = np.where(total > 0.0, means[:, 0] / np.where(total > 0.0, total, 1.0), 0.5)
        if self._sensors is None:
            self._sensors = SeenJoints(len(rows.body)), SeenJoints(len(rows.body))
        a, b = self._sensors
        seen_a = a.add(rows.states_a, rows.clock_a, rows.time_ns)
        return np.where(seen_a | b.add(rows.states_b, rows.clock_b, rows.time_ns), share, np.nan)


@cache
def _palette() -> NDArray[np.uint8]:
    """(_SHADES + 2, 3) RGB: from B's colour over that of S* to A's, then the predicted colour."""
    a, b, both = (np.array(SKELETON_COLORS[key]) for key in ("a", "b", "fused"))
    half = _SHADES // 2
    ramps = np.linspace(b, both, half + 1)[:-1], np.linspace(both, a, half + 1), [PREDICTED_COLOR]
    return np.concatenate(ramps).astype(np.uint8)


class LimbSources:
    """Finds which view each limb of S* follows, smoothed over a third of a second."""

    def __init__(self, body: Body) -> None:
        members = [[limb == name for limb in _limbs_of(body)] for name in LIMBS]
        self._members = np.array(members, dtype=np.float64)
        self._mean = _RunningMean(_LIMB_SECONDS)

    def add(self, rows: SessionArrays) -> NDArray[np.int64]:
        """(T, 6) indices into :data:`SOURCES` by the limbs of :data:`LIMBS`, for frames in time order."""
        known = ~rows.predicted
        each = rows.weights_a * known, rows.weights_b * known, rows.predicted
        sums = np.stack([values.astype(np.float64) @ self._members.T for values in each], axis=1)
        means = self._mean.add(sums, rows.time_ns)
        from_a, from_b, predicted = means.transpose(1, 0, 2)
        total = from_a + from_b
        source = np.where(from_a > _MOSTLY * total, 0, np.where(from_b > _MOSTLY * total, 1, 2))
        return np.where(predicted > 0.5 * self._members.sum(axis=1), 3, source)


class _RunningMean:
    """An exponential mean over time, the same at any frame rate. (scipy.signal loads for a second.)"""

    def __init__(self, seconds: float) -> None:
        self._seconds = seconds
        self._mean: NDArray[np.float64] | None = None
        self._time_ns: int | None = None

    def add(self, values: NDArray[np.float64], time_ns: NDArray[np.int64]) -> NDArray[np.float64]:
        """(T, …) means of values (T, …) of frames in time order."""
        first_ns = int(time_ns[0]) if self._time_ns is None else self._time_ns
        elapsed = np.maximum(np.diff(time_ns, prepend=first_ns), 0) * 1e-9
        means, mean = np.empty_like(values), values[0] if self._mean is None else self._mean
        for k, kept in enumerate(np.exp(-elapsed / self._seconds).tolist()):
            means[k] = mean = kept * mean + (1.0 - kept) * values[k]
        self._mean, self._time_ns = means[-1].copy(), int(time_ns[-1])
        return means


def _limbs_of(body: Body) -> list[str]:
    """The limb of :data:`LIMBS` to which each joint belongs."""
    names = []
    for joint, limb in zip(body.joints, limbs(body).tolist(), strict=True):
        side = "left" if "left" in joint.lower() else "right"
        head = kind_of(joint) in ("head", "face") or "neck" in joint.lower()
        names.append("head" if head else {ARM: f"{side} arm", LEG: f"{side} leg"}.get(limb, "trunk"))
    return names
