"""Fuses the pairs of a session again, and compares S* with the recorded one."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from itertools import islice
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from fusion.facing.labels import DOUBT_STEPS, Labels
from fusion.plan import plan_recording
from fusion.setup import FuserSettings
from recordings.data.checksums import fused_checksums, joint_digests
from recordings.data.images import NO_IMAGES
from recordings.data.session_arrays import SessionFrames
from recordings.fusing.pairs import Segments, block_count, calibration_event, fuse_segments, setups_of
from recordings.fusing.view_events import watch
from recordings.session import Session

CUT_WITHIN = 1e-6  # metres; float32 shows 2.4e-7 at 4 m
SHARE_AGREEING = 0.99
_SETTLED_NS = 1_000_000_000  # the time in which the estimator forgets a person


@dataclass(frozen=True, eq=False)
class Replay:
    """How a session is fused again.

    Attributes:
        session: The session.
        segments: The setups, each with its frames.
        labels: The sides and headings that are given to the fuser; None: it finds them.
    """

    session: Session
    segments: Segments
    labels: Labels | None

    @staticmethod
    def of(session: Session, settings: FuserSettings | None = None) -> Replay:
        """Takes from the session what its own method recorded, and finds what another method lacks.

        Args:
            settings: Of the replay; None: the session's own, with which S* is the same bit for bit.
        """
        settings = settings or session.settings
        if settings.method == "duplex" and session.settings.method != "duplex":
            # The session has neither labels nor a refined calibration: they are found as for two recordings.
            settings = replace(settings, hindsight="labels")
            skeletons = session.recorded_pairs.skeletons
            plan = plan_recording(session.body, skeletons, settings, session.calibration)
            cameras = session.intrinsics_a, session.intrinsics_b
            return Replay(session, setups_of(plan, settings, cameras), plan.labels)
        rows, labels = session.rows, None
        if rows.exchanged is not None:
            # where the sides were found pair by pair, doubt and heading are found again, to the bit
            again = settings.hindsight == "none"
            doubt = 0.0 if rows.side_doubt is None else rows.side_doubt / DOUBT_STEPS
            labels = Labels.with_sides(rows.exchanged, np.nan if again else doubt)
            if rows.heading is not None and not again:
                labels.heading[:] = rows.heading
        return Replay(session, list(session.setups(settings)), labels)

    def __len__(self) -> int:
        """The number of blocks."""
        return block_count(self.segments)

    def blocks(self) -> Iterator[SessionFrames]:
        """Fuses block after block."""
        return fuse_segments(self.segments, self.session.recorded_pairs, self.labels)

    def fused(self, blocks: Iterable[SessionFrames] | None = None, images: bool = True) -> Session:
        """The session of the replay, with the events that it finds itself. Damage of the first one remains.

        Args:
            blocks: Those of :meth:`blocks`, if the caller passes them on; None: they are fused now.
            images: Whether it has the images of the first one.
        """
        of, time_ns = self.session, self.session.time_ns
        events = [calibration_event(setup, own, time_ns) for setup, own in self.segments]
        watched = watch(of.body, self.blocks() if blocks is None else blocks, int(time_ns[0]), events)
        replayed = Session.of(
            [(setup, islice(watched, block_count([(setup, own)]))) for setup, own in self.segments],
            of.sources,
            images=of.images if images else NO_IMAGES,
            about=of.origin | {"first_frame": of.first_frame, "replay_of": of.name},
        )
        in_order = tuple(sorted(events, key=lambda event: event.frame))
        rows = replace(replayed.rows, up=of.rows.up, unix_ns=of.rows.unix_ns)
        return replace(replayed, rows=rows, events=in_order, damage=of.damage, frames_lost=of.frames_lost)


@dataclass(frozen=True)
class Agreement:
    """How S* of a replay agrees with the recorded one.

    Attributes:
        kind: "bits": every bit is the same. A session that is trimmed at its beginning lacks the frames
            before, so that less can be asked of it: "rounded": from frame `settled` on, S* is the same within
            CUT_WITHIN. "sigma": once settled, SHARE_AGREEING of the joints are within one standard deviation.
            "none": none of these.
        differing: The number of frames that differ in a bit.
        frame, joint: The first that differ; the joint is None if not even its digest differs.
        apart: Metres between both there; 0 where the recorded float32 does not show it.
        worst: The largest such distance; NaN if some frame has only one S*.
        settled: The first frame without predicted joints.
    """

    kind: Literal["bits", "rounded", "sigma", "none"]
    differing: int = 0
    frame: int = 0
    joint: str | None = None
    apart: float = 0.0
    worst: float = 0.0
    settled: int = 0

    @staticmethod
    def of(session: Session, fused: NDArray[np.float64]) -> Agreement:
        """Compares S* (T, J, 3), fused again, with that of the session."""
        differing = np.flatnonzero(fused_checksums(fused) != session.fused_checksums)
        if len(differing) == 0:
            return Agreement("bits")
        t, rows = int(differing[0]), session.rows
        apart = np.linalg.norm(fused - rows.fused, axis=2)
        one_missing = bool((np.isnan(fused) != np.isnan(rows.fused)).any())
        # A joint without data depends on the frame before.
        settled = int(np.argmin(rows.predicted.any(axis=1)))
        kind: Literal["rounded", "sigma", "none"] = "none"
        if (session.first_frame or session.left_out) and not one_missing:
            if np.nanmax(apart[settled:]) < CUT_WITHIN:
                kind = "rounded"
            elif session.settings.method == "duplex" and _within_sigma(session, apart):
                kind = "sigma"
        now, recorded = fused[t].astype(np.float32), rows.fused[t].astype(np.float32)
        visible = ~np.isclose(now, recorded, 0, 0, equal_nan=True).all(axis=1)
        joints = (
            visible if visible.any() else joint_digests(fused[t : t + 1])[0] != session.rows.joint_digests[t]
        )
        j = int(np.argmax(joints))
        return Agreement(
            kind,
            len(differing),
            t,
            session.body.joints[j] if joints.any() else None,
            float(apart[t, j]) if visible.any() else 0.0,
            np.nan if one_missing else float(np.nanmax(apart)),
            settled,
        )


def _within_sigma(session: Session, apart: NDArray[np.float64]) -> bool:
    """Whether S* is the recorded one within its standard deviation, after a second or half of the session.

    The estimator of the method ``duplex`` remembers the frames before, which a trim has cut off.

    Args:
        apart: (T, J) metres.
    """
    settled = session.time_ns >= min(_SETTLED_NS, int(session.time_ns[-1]) // 2)
    within = (apart <= session.rows.filled("sigma"))[settled]
    return bool(np.mean(within[np.isfinite(apart[settled])]) >= SHARE_AGREEING)
