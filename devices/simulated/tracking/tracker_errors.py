"""The errors of a Kinect's body tracker. Each error is a knob that can be turned off."""

from __future__ import annotations

import tomllib
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from functools import cache
from pathlib import Path

import numpy as np

from devices.simulated.tracking.mirroring import Mirroring
from fusion.body import Body
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
    skin: float = 0.0  # shift of all joints along the ray towards the sensor, metres
    lean: float = 0.0
    """Shift of a joint along the ray away from the sensor for each metre above the root. Kinect v2: 18 real
    walks and steps. Azure Kinect: squats of five people, 5 ± 14 mm."""
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
        return _tables()[body.name]


@cache
def _tables() -> dict[str, TrackerErrors]:
    tables = tomllib.loads((Path(__file__).parent / "tracker_errors.toml").read_text(encoding="utf-8"))
    found: dict[str, TrackerErrors] = {}
    for name, values in tables.items():
        others = found.get(values.pop("as", ""), TrackerErrors())
        values["unsure"] = _SURE | values.get("unsure", others.unsure)
        values["mirroring"] = Mirroring(**values["mirroring"])
        found[name] = replace(others, **values)
    return found
