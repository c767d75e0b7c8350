"""The errors of a Kinect's body tracker. Each error is a knob that can be turned off."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from devices.simulated.tracking.mirroring import Mirroring
from fusion.body import AZURE_KINECT, BLAZEPOSE, KINECT_V1, KINECT_V2, Body
from fusion.joint_kinds import KINDS
from fusion.support.types import Array

ByKind = Mapping[str, float]
"""One value for each kind of joint (:mod:`fusion.joint_kinds`)."""
_SURE: dict[str, float] = dict.fromkeys(KINDS, 0.0)
AddedErrors = Callable[[Body, float, np.random.Generator], Iterator[Array]]
"""From the body, the frame interval in seconds and a generator: (J, 3) errors per frame, metres."""


@dataclass(frozen=True)
class TrackerErrors:
    """The errors of one body tracker: none by default. Lengths are metres, times seconds.

    The defaults of :meth:`of` are fitted to real recordings (``tests/devices/simulated/test_realism.py``).
    Only ``bones`` of the Azure Kinect is not, of which no two real views of one person are there: it is to
    that of the Kinect v2 as ``view_bias`` is. Those of BlazePose, of which there are no recordings, were read
    off the tracker itself on simulated images (``python -m tests.experiments.own_tracker --joints`` of commit
    a82937b).
    """

    view_bias: float = 0.0
    """Standard deviation per axis of a joint's bias, which is constant in time and depends on the view, but
    for the ``shared`` part."""
    skin: float = 0.0
    """Shift of a joint along the ray towards the sensor, as a share of its depth under the skin."""
    seen_share: float = 0.0  # visible share of a joint's surface below which it is hidden
    unsure: ByKind = field(default_factory=lambda: _SURE)
    """Share of time in which a visible joint counts as hidden, by kind."""
    inferred_error: float = 0.0  # standard deviation per axis of the guess for a hidden joint
    inferred_jitter: float = 1.0  # factor of the jitter of a hidden joint
    not_tracked: float = 0.0  # share of hidden spells in which the joint has no position
    mistracked: float = 0.0  # share of hidden spells in which the joint is still reported as tracked
    snap: float = 0.0
    """Shift of such a joint towards the joint that covers it, as a share of their distance, 0 to 1."""
    stretch: float = 1.0
    """Share of a bone's length error that remains. The body model of a tracker keeps bone lengths nearly
    constant, so that an error of a joint also moves the joints below it. With 1 the errors of joints are
    independent."""
    bones: float = 0.0
    """Standard deviation of a bone's length in one sensor's skeletons, over the truth; constant in time."""
    shared: float = 0.0
    """Share of the variance of ``view_bias`` and ``bones`` that both sensors have in common: one network's
    errors about one person. Unknown of real sensors, of which no pair with truth is published."""
    outliers: float = 0.0  # share of frames in which a tracked joint has an outlier
    outlier_size: float = 0.0  # largest size of an outlier per axis
    rescale: float = 0.0  # standard deviation of the skeleton's scale
    rescale_seconds: float = 1.0  # duration of a scale
    jitter: ByKind = field(default_factory=lambda: _SURE)
    """Standard deviation of a joint's jitter per axis, by kind."""
    moving_jitter: float = 0.0  # increase of ``jitter`` per axis for each m/s of the joint's speed
    jitter_memory: float = 0.5  # correlation of the jitter of successive frames
    mirroring: Mirroring = field(default_factory=Mirroring)
    """Frequency and form of mirroring: a person whose back is turned is reported mirrored."""
    stale: float = 0.0  # share of frames that repeat the previous skeleton
    lost: float = 0.0  # share of frames in which the person is lost
    lost_seconds: float = 0.5  # duration of a loss
    added: AddedErrors | None = None  # further errors; None for none

    @staticmethod
    def of(body: Body) -> TrackerErrors:
        """Returns the errors of the tracker that reports this body."""
        return _OF[body.name]


_KINECT_V2 = TrackerErrors(
    view_bias=0.023, skin=0.25, seen_share=0.35,
    unsure=_SURE | {"hand": 0.03, "tip": 0.05, "thumb": 0.05, "foot": 0.05},
    inferred_error=0.14, inferred_jitter=2.0, not_tracked=0.02, mistracked=0.4, snap=0.6,
    stretch=0.12, bones=0.047, outliers=0.0065, outlier_size=0.17, rescale=0.018, rescale_seconds=2.0,
    jitter={
        "spine": 0.0016, "head": 0.001, "girdle": 0.0024, "elbow": 0.0024, "wrist": 0.0036, "hand": 0.005,
        "tip": 0.005,
        "thumb": 0.014, "knee": 0.0018, "ankle": 0.001, "foot": 0.002, "face": 0.003,
    },
    moving_jitter=0.002, jitter_memory=0.7, mirroring=Mirroring(back=0.97, faces_sensor=1.0, heading_sd=0.2),
    stale=0.05, lost=0.002,
)  # fmt: skip
_KINECT_V1 = replace(
    _KINECT_V2,
    view_bias=0.03, stretch=0.5, bones=0.03, inferred_error=0.16,
    jitter={kind: 2.0 * size for kind, size in _KINECT_V2.jitter.items()},
    mirroring=Mirroring(back=0.97, faces_sensor=0.5), stale=0.0,
)  # fmt: skip
"""Assumed: no recordings of two of them are published. Its tracker takes backs for fronts, too, but does not
hold bone lengths, and its depth image is rougher. How far a person turns to it is
not known; half is assumed."""
_AZURE = TrackerErrors(
    view_bias=0.009, skin=0.15, seen_share=0.35,
    unsure=_SURE | {"hand": 0.10, "tip": 0.2, "thumb": 0.3, "foot": 0.16},
    inferred_error=0.06, inferred_jitter=2.5, not_tracked=0.65, mistracked=0.25, snap=0.6,
    stretch=0.16, bones=0.02, outliers=0.005, outlier_size=0.20, rescale=0.028, rescale_seconds=0.6,
    jitter={**_KINECT_V2.jitter, "spine": 0.0012, "girdle": 0.0020},
    moving_jitter=0.002, jitter_memory=0.7, mirroring=Mirroring(back=0.05),
    stale=0.04, lost=0.001,
)  # fmt: skip
_BLAZEPOSE = TrackerErrors(
    view_bias=0.012, skin=0.0, seen_share=0.35,
    unsure={
        "spine": 0.03, "head": 0.0, "girdle": 0.35, "elbow": 0.12, "wrist": 0.2, "hand": 0.3, "tip": 0.0,
        "thumb": 0.35,
        "knee": 0.02, "ankle": 0.05, "foot": 0.2, "face": 0.03,
    },
    inferred_error=0.08, inferred_jitter=2.0, not_tracked=0.0, mistracked=0.08, snap=0.6,
    stretch=0.5, outliers=0.02, outlier_size=0.20, rescale=0.02, rescale_seconds=0.6,
    jitter={
        "spine": 0.0037, "head": 0.0026, "girdle": 0.0035, "elbow": 0.0037, "wrist": 0.0056, "hand": 0.0048,
        "tip": 0.0048, "thumb": 0.0049, "knee": 0.0033, "ankle": 0.0044, "foot": 0.0057, "face": 0.0033,
    },
    moving_jitter=0.002, jitter_memory=0.7, mirroring=Mirroring(back=0.12),
)  # fmt: skip
"""Rounded from four simulated scenes (seed 100). It repeats no frame: it works on each image."""
_OF = {
    KINECT_V1.name: _KINECT_V1,
    KINECT_V2.name: _KINECT_V2,
    AZURE_KINECT.name: _AZURE,
    BLAZEPOSE.name: _BLAZEPOSE,
}
