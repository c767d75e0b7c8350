"""What follows from the data of a session: S* at any time, angles, rotations, gait, quality."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from datetime import timedelta
from functools import cached_property
from itertools import groupby
from typing import TYPE_CHECKING, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from devices.events import Spell, spells_of
from devices.frame_pairs import FramePair, RecordedPairs
from fusion.body import ADULT_HEIGHT
from fusion.calibration.calibration import Calibration
from fusion.facing.evidence import upright_direction
from fusion.movement.angles import ANGLES, angle_sigma, joint_angles
from fusion.pair_arrays import Pairs, View
from fusion.support.read_only import read_only
from recordings.data import layout
from recordings.data.interpolation import nanoseconds, positions_at, sigma_at
from recordings.data.series import AngleSeries, PersonSpan, QualitySeries, RotationSeries, SkeletonSeries
from recordings.data.session_data import SessionData

if TYPE_CHECKING:  # what one reads who opens a session is this module; the rest is imported when asked for
    from recordings.gait import Gait
    from recordings.quality.per_second import SecondQuality, Span
    from recordings.quality.verdict import Verdict

_ROUNDED = 1e-3  # of the length of a unit vector
_SAMPLES = 9000  # frames, from which a person's usual place is found


@dataclass(frozen=True, eq=False, repr=False)
class SessionSeries(SessionData):
    """The data of a session, and what follows from it; see :class:`recordings.session.Session`.

    Everything is computed once, when it is first asked for. Arrays are read-only; ``array.copy()`` is not.
    """

    def __repr__(self) -> str:
        return f"<Session {self.name}: {len(self)} frames, {self.time[-1]:.1f} s, {self.body.name}>"

    @property
    def time_ns(self) -> NDArray[np.int64]:
        """(T,) nanoseconds since the first frame, for exact work; see :attr:`time`."""
        return self.rows.time_ns

    @cached_property
    def time(self) -> NDArray[np.float64]:
        """(T,) seconds since the first frame."""
        return read_only(np.asarray(self.rows.time_ns * 1e-9))

    @cached_property
    def skeleton_a(self) -> SkeletonSeries:
        """S_A of the principal sensor, in K_A's frame, which is the world frame."""
        rows = self.rows
        return SkeletonSeries(rows.positions_a, rows.states_a, rows.weights_a, rows.clock_a, rows.stale_a)

    @cached_property
    def skeleton_b(self) -> SkeletonSeries:
        """S_B of the secondary sensor, in K_B's frame; see :attr:`b_in_a`."""
        rows = self.rows
        return SkeletonSeries(rows.positions_b, rows.states_b, rows.weights_b, rows.clock_b, rows.stale_b)

    @cached_property
    def b_in_a(self) -> NDArray[np.float64]:
        """(T, J, 3) metres, the positions of S_B in K_A's frame."""
        return read_only(self.rows.b_in_a)

    @property
    def fused(self) -> NDArray[np.float64]:
        """(T, J, 3) S* in K_A's frame, metres; NaN where S* is missing. A file stores it as float32."""
        return self.rows.fused

    @cached_property
    def sigma(self) -> NDArray[np.float64]:
        """(T, J) metres, one standard deviation of a joint of S*; NaN with the paper's methods."""
        return read_only(self.rows.filled("sigma").astype(np.float64))

    @property
    def truth(self) -> NDArray[np.float64] | None:
        """(T, J, 3) metres, the true joints in K_A's frame; None unless the sensors are simulated."""
        return self.rows.truth

    def at(self, time: ArrayLike | timedelta) -> NDArray[np.float64]:
        """S* at any times, with bones of constant length; see
        :func:`recordings.data.interpolation.positions_at`.

        Args:
            time: One or (N,) seconds since the first frame, or durations, as of numpy or pandas.

        Returns:
            (N, J, 3) metres in K_A's frame; NaN where the session has no S*, as before and after it.

        Raises:
            RecordingError: A time is a day or more from the session, as nanoseconds are, or is no time.
        """
        return positions_at(self.rows, nanoseconds(self.rows, time))

    def sigma_at(self, time: ArrayLike | timedelta) -> NDArray[np.float64]:
        """(N, J) metres, one standard deviation of :meth:`at`."""
        return sigma_at(self.rows, nanoseconds(self.rows, time))

    @cached_property
    def up(self) -> NDArray[np.float64]:
        """(3,) unit vector against gravity in K_A's frame, from the person's standing."""
        step = max(1, len(self) // _SAMPLES)
        with np.errstate(invalid="ignore", over="ignore"):  # a damaged file has any numbers
            return read_only(upright_direction(self.body, np.asarray(self.rows.fused[::step])))

    @cached_property
    def never_seen(self) -> tuple[str, ...]:
        """Names of the joints that no sensor reports in any frame. In S* the bones alone place them."""
        return tuple(np.array(self.body.joints)[self.rows.never_seen].tolist())

    @cached_property
    def angles(self) -> AngleSeries:
        """Joint angles of S*; NaN where they need a joint that was never seen.

        Those of the trunk are against the vertical that live outputs had, where there is one, else against
        :attr:`up`.
        """
        seen, sigma = self.rows.seen, self.rows.filled("sigma")
        degrees, deviations = np.full((2, len(self), len(ANGLES)), np.nan)
        verticals, of = np.unique(self.up_of_frames, axis=0, return_inverse=True)
        for k, up in enumerate(verticals):  # a live one changes once a second at most
            own = np.flatnonzero(of.ravel() == k) if len(verticals) > 1 else slice(None)
            degrees[own] = joint_angles(self.body, seen[own], up)
            deviations[own] = angle_sigma(self.body, seen[own], sigma[own], up)
        return AngleSeries(ANGLES, read_only(degrees), read_only(deviations))

    @property
    def up_of_frames(self) -> NDArray[np.float64]:
        """(T, 3) the vertical of :attr:`angles`: that of live outputs, or else :attr:`up`."""
        up = np.broadcast_to(self.up, (len(self), 3))
        if self.rows.up is None:
            return up
        with np.errstate(invalid="ignore", over="ignore"):  # a damaged file has any numbers
            sent = np.abs(np.linalg.norm(self.rows.up, axis=1) - 1.0) < _ROUNDED
        return np.where(sent[:, None], self.rows.up.astype(np.float64), up)

    @cached_property
    def rotations(self) -> RotationSeries:
        """Rotations of the bones of S*, and of the body."""
        from fusion.movement.joint_rotations import rotations_of

        turned = rotations_of(self.body, self.rows.fused, self.rows.time_ns)
        return RotationSeries(self.body, read_only(turned))

    @cached_property
    def gait(self) -> Gait:
        """Heel strikes, toe-offs, steps and turns of S*; see :mod:`recordings.gait.events`."""
        from recordings.gait.events import find_gait

        found = find_gait(self.body, self.time_ns, self.rows.seen, self.up, self.rows.sigma)
        return replace(found, time=self.time, angles=self.angles)

    @property
    def recorded_pairs(self) -> RecordedPairs:
        """The pairs as given by the sensors, without images, so that a session can serve as a source."""
        rows, number = self.rows, np.arange(len(self))
        clocks = rows.clock_a, rows.clock_b
        views = (
            View(rows.clock_a, rows.positions_a, rows.states_a, rows.witness_a),
            View(rows.clock_b, rows.positions_b, rows.states_b, rows.witness_b),
        )
        frames = np.stack([np.where(clock == layout.NO_FRAME, -1, number) for clock in clocks], axis=1)
        return RecordedPairs(Pairs(rows.body, views, rows.time_ns, rows.skew_ns, frames))

    def pairs(self, depth: bool = False) -> Iterator[FramePair]:
        """The pairs as given by the sensors, one by one."""
        images = {side: iter(self.depth(side) if depth else ()) for side in layout.VIEWS}
        ahead = {side: next(images[side], None) for side in layout.VIEWS}
        for t, pair in enumerate(self.recorded_pairs):
            for side, image in ahead.items():
                if image is not None and image[0] == t:
                    pair = replace(pair, **{side: replace(getattr(pair, side), depth=image[1])})
                    ahead[side] = next(images[side], None)
            yield pair

    @property
    def bone_lengths(self) -> NDArray[np.float64]:
        """(T, J) target lengths of the bones of S*, metres, indexed by the child joint; 0 at the root."""
        return self.rows.bone_lengths

    @cached_property
    def people(self) -> tuple[PersonSpan, ...]:
        """The people whose bones S* has, in time order. People of equal size count as one person."""
        spans, bones = [], self.body.bone_joints
        for person, of in groupby(self.setups(), key=lambda each: each[0].calibration.person):
            setups, frames = zip(*of, strict=True)
            first, end, lengths = frames[0].start, frames[-1].stop, setups[-1].calibration.bone_lengths
            height = ADULT_HEIGHT * float(np.median(lengths[bones] / self.body.nominal_lengths[bones]))
            seconds = float(self.time[first]), float(self.time[end - 1])
            spans.append(PersonSpan(person, first, end, seconds, height, lengths))
        return tuple(spans)

    @property
    def rotation(self) -> NDArray[np.float64]:
        """(T, 3, 3) R, K_A ← K_B."""
        return self.rows.rotation

    @property
    def translation(self) -> NDArray[np.float64]:
        """(T, 3) t, K_A ← K_B, metres: the position of K_B in K_A's frame.

        It changes with a calibration; with the method ``paper`` in every frame.
        """
        return self.rows.translation

    @cached_property
    def quality(self) -> QualitySeries:
        """Quality figures per frame."""
        rows = self.rows
        return QualitySeries(
            rows.bone_error, rows.disagreement, rows.skew_ns, rows.fuse_ms, rows.iterations, rows.predicted
        )

    @cached_property
    def quality_per_second(self) -> tuple[SecondQuality, ...]:
        """How good each second is; see :func:`recordings.quality.per_second.quality_per_second`."""
        from recordings.quality.per_second import quality_per_second

        return quality_per_second(self)

    @property
    def good_spans(self) -> tuple[Span, ...]:
        """The good seconds of :attr:`quality_per_second`, joined to stretches of time."""
        from recordings.quality.per_second import good_spans

        return good_spans(self, self.quality_per_second)

    @cached_property
    def good_frames(self) -> NDArray[np.bool_]:
        """(T,) whether a frame is in a good second."""
        from recordings.quality.per_second import good_frames

        return read_only(good_frames(self, self.quality_per_second))

    def part(self, frames: ArrayLike | slice) -> Self:
        """Some frames as a session in memory: ``session.part(session.good_frames)``.

        Its numbers and times start at 0. A gap between the frames stays in the times.

        Args:
            frames: (N,) their numbers, increasing; or (T,) flags, or a slice. For times:
                ``session.part((session.time >= 2.0) & (session.time < 5.0))``.

        Raises:
            RecordingError: There are none, or the session does not have them in this order.
        """
        from recordings.data.session_parts import part_of

        return part_of(self, frames)

    @cached_property
    def verdict(self) -> Verdict:
        """How good the session is, why, and the figures of ``duplex fuse --report``."""
        from recordings.quality.figures import report
        from recordings.quality.verdict import verdict

        return verdict(report(self))

    @property
    def calibration(self) -> Calibration:
        """R, t, the bone lengths and the agreement of the views; the last calibration of the session."""
        return self.calibrations[-1][1]

    @cached_property
    def frame_rate(self) -> float:
        """Frames per second; see :attr:`recordings.data.session_arrays.SessionArrays.frame_rate`."""
        return self.rows.frame_rate

    @property
    def spells(self) -> list[Spell]:
        """Conditions that lasted, each from its start event to its end event."""
        return spells_of(self.events)

    @cached_property
    def whereabouts(self) -> NDArray[np.float64]:
        """(3,) metres in K_A's frame, the median position of the person; a point in front of K_A without a
        person."""
        step = max(1, len(self) // _SAMPLES)
        some = [rows.fused[rows.frame % step == 0] for rows in self.rows.parts()]
        points = np.concatenate(some).reshape(-1, 3)
        seen = points[np.isfinite(points).all(axis=1)]
        return read_only(np.asarray(np.median(seen, axis=0)) if len(seen) else np.array([0.0, 0.0, 2.5]))
