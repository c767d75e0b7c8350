"""The methods that the benchmark of accuracy compares: one row each, from the simplest to ours.

To add a method, add a row to :data:`METHODS`.
"""

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import chain
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from devices.frame_pairs import RecordedPairs
from fusion.body import Body
from fusion.calibration.calibration import Calibration
from fusion.fuser import Fuser
from fusion.plan import plan_recording
from fusion.registration.rigid_fit import fit_recording
from fusion.setup import FuserSettings, FusionSetup
from recordings.fusing.pairs import fuse_segments, setups_of
from recordings.live_fusion import LiveFusion
from tests.benchmarks import baselines

Array = NDArray[np.float64]
Kind = Literal["view", "baseline", "bound", "method"]


@dataclass(frozen=True, eq=False)
class RecordedPair:
    """The input of every method, and the truth, which only bounds and figures use.

    Attributes:
        body: The body that defines the joints.
        pairs: T pairs, in time order.
        calibration: Calibration from the start-up pose.
        frame_seconds: Seconds between two frames.
        truth: (T, J, 3) metres, in K_A's frame.
    """

    body: Body
    pairs: RecordedPairs
    calibration: Calibration
    frame_seconds: float
    truth: Array

    @cached_property
    def _views(self):
        skeletons = [pair.skeletons for pair in self.pairs]
        nowhere = np.full((len(self.body), 3), np.nan)
        unseen = np.zeros(len(self.body), dtype=np.uint8)

        def stacked(side):
            view = [getattr(pair, side) for pair in skeletons]
            positions = np.array([nowhere if s is None else s.positions for s in view], dtype=np.float64)
            return positions, np.array([unseen if s is None else s.states for s in view])

        return stacked("a"), stacked("b")

    @property
    def a(self):
        """(T, J, 3) S_A, metres, in K_A's frame; NaN where not tracked."""
        return self._views[0][0]

    @property
    def b(self):
        """(T, J, 3) S_B, in K_B's frame."""
        return self._views[1][0]

    @property
    def states(self):
        """(T, J) tracking states of A and of B."""
        return self._views[0][1], self._views[1][1]

    @cached_property
    def refined(self):
        """``a_from_b`` fitted robustly over the whole recording's movement, tracked joints only."""
        sure = (self.states[0] == 2) & (self.states[1] == 2)
        return fit_recording(np.where(sure[..., None], self.a, np.nan), self.b)


@dataclass(frozen=True, eq=False)
class Found:
    """The result of a method.

    Attributes:
        joints: (T, J, 3) metres, in K_A's frame; NaN without an estimate.
        sd: (T, J) metres, one standard deviation of a joint's distance to the truth; None without.
    """

    joints: Array
    sd: Array | None = None


@dataclass(frozen=True)
class Method:
    """A row of every table.

    Attributes:
        name: At most 18 characters.
        kind: A bound uses the truth and is out of competition.
        find: From a recording to joints.
    """

    name: str
    kind: Kind
    find: Callable[[RecordedPair], Found] = field(repr=False)


def fused(settings):
    """Our program with these settings, pair by pair."""

    def find(recording):
        fuser = Fuser(FusionSetup(recording.calibration, settings))
        return _found([fuser.update(pair.skeletons) for pair in recording.pairs])

    return find


def as_recorded(settings):
    """What ``duplex fuse`` makes of the recording: calibration and labels from the whole of it."""

    def find(recording):
        plan = plan_recording(recording.body, recording.pairs.skeletons, settings)
        segments = setups_of(plan, settings, (None, None))
        frames = chain.from_iterable(fuse_segments(segments, recording.pairs, plan.labels))
        return _found([frame.fused for frame in frames])

    return find


def without_depth(settings):
    """As :func:`as_recorded`, without the evidence of depth images."""

    def find(recording):
        pairs = recording.pairs.skeletons
        a, b = (view._replace(witness=None) for view in pairs.views)
        blind = RecordedPairs(replace(pairs, views=(a, b)))
        return as_recorded(settings)(replace(recording, pairs=blind))

    return find


def as_live(settings):
    """What ``duplex live`` makes of the recording, refinement included: nothing looks ahead."""

    def find(recording):
        live = LiveFusion(FusionSetup(recording.calibration, settings), refine=True)
        frames = []
        for pair in recording.pairs:
            frames.append(live.fuse(pair))
            live.learn(frames[-1])
        return _found([frame.fused for frame in frames])

    return find


def _found(frames):
    sigma = [frame.sigma for frame in frames]
    known = [one for one in sigma if one is not None]
    return Found(
        np.array([frame.positions for frame in frames]),
        np.array(known) if len(known) == len(sigma) else None,
    )


def _baseline(find):
    return lambda recording: Found(find(recording))


def _mean(recording):
    return baselines.mean(recording.a, recording.refined.apply(recording.b))


def _kalman(recording):
    views = recording.a, recording.refined.apply(recording.b)
    return baselines.kalman(*views, *recording.states, recording.frame_seconds)


def _tracked_wins(recording):
    return baselines.tracked_wins(recording.a, recording.refined.apply(recording.b), *recording.states)


def _oracle(recording):
    return baselines.oracle(recording.a, recording.refined.apply(recording.b), recording.truth)


DEFAULT = FuserSettings()
"""The default settings."""

WITHOUT_DEPTH = "without depth"
"""A method for recordings with depth images."""

METHODS = (
    Method("A alone", "view", _baseline(lambda r: baselines.alone(r.a))),
    Method("B alone", "view", _baseline(lambda r: baselines.alone(r.refined.apply(r.b)))),
    Method("mean, refined", "baseline", _baseline(_mean)),
    Method("tracked wins", "baseline", _baseline(_tracked_wins)),
    Method("Kalman, refined", "baseline", _baseline(_kalman)),
    Method("oracle", "bound", _baseline(_oracle)),
    Method("paper", "method", fused(replace(DEFAULT, method="paper"))),
    Method("duplex", "method", as_recorded(replace(DEFAULT, hindsight="labels"))),
    Method("duplex, live", "method", as_live(DEFAULT)),
    Method("duplex, smoothed", "method", as_recorded(replace(DEFAULT, hindsight="whole"))),
    Method(WITHOUT_DEPTH, "method", without_depth(replace(DEFAULT, hindsight="labels"))),
)
"""In the order of the tables.

``refined``: registered by a robust fit over the whole recording. ``oracle`` is the better view of every joint
in every frame. ``paper`` has the paper's weights and exact bones; ``duplex`` is the estimator in time."""

OURS = "duplex"
"""The method that the tables compare the others with: the default."""
