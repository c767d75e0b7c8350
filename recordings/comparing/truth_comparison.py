"""Compares S_A, S_B and S* of a session with motion capture of the same movement.

The files share neither clock (:mod:`recordings.comparing.truth_timing`) nor frame. One rigid transform takes
the truth to K_A's frame, by a robust fit to all joints of all three skeletons in all frames; nothing is
scaled.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property, partial
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from devices.skeletons.name_tables import NameTable, fitting_table
from devices.skeletons.stated_format import METRES
from fusion.body import Body
from fusion.clocks.fit import correlation_at
from fusion.errors import CalibrationError
from fusion.movement.angles import joint_angles
from fusion.movement.joint_rotations import rotations_of
from fusion.pair_arrays import View
from fusion.registration.rigid_fit import fit_recording
from fusion.rigid import RigidTransform
from fusion.support.large_arrays import parts
from fusion.support.medians import median_of_known
from fusion.support.types import Array
from recordings.comparing.truth_files import TruthFile
from recordings.comparing.truth_timing import JointPath, TimeOffset, find_offset, path_of, view_of
from recordings.errors import RecordingError
from recordings.session_series import SessionSeries

SKELETONS = ("a", "b", "fused")
"""S_A, S_B and S*, as in :data:`recordings.data.layout.SKELETON_NAMES`."""
_FEWEST_FRAMES = 24
_SIZE_WITHIN = 1.4  # factor between the sizes of the person in both files
_MOST_FITTED = 3000  # frames that the transform is fitted to
_LARGEST_RESIDUAL = 0.12  # metres, the median of S*; others whose displacements correlate are 0.17 apart
_NAMED = 0.9  # correlation at which a variant of a truth is said to be the right one
_MIRROR = np.array([-1.0, 1.0, 1.0], dtype=np.float32)
_OWN_FRAME = 0.3  # metres that a fit moves a truth that is in K_A's frame
_MIRRORED = 0.6  # of the residual: a mirror image that fits so much better is right


@dataclass(frozen=True, eq=False)
class TruthComparison:
    """The T frames of a session that have S* and are covered by the truth; metres, K_A's frame.

    Attributes:
        body: The body of the session.
        truth_name: The file of the truth.
        table: The table of names that maps its points to joints.
        joints: (M,) the joints that the truth has.
        unit: The truth's unit of length, in words.
        offset: Between the clocks.
        a_from_truth: K_A ← the truth's frame.
        residual: Metres between S* and the truth after this fit, the median.
        frame, time_ns: (T,) numbers and times of the frames.
        found: (T, J, 3) by :data:`SKELETONS`.
        truth: (T, J, 3) by the same keys, when the skeleton was captured.
        up: (3,) unit vector against gravity.
    """

    body: Body
    truth_name: str
    table: str
    joints: NDArray[np.int64]
    unit: str
    offset: TimeOffset
    a_from_truth: RigidTransform
    residual: float
    frame: NDArray[np.int64]
    time_ns: NDArray[np.int64]
    found: dict[str, NDArray[np.float32]]
    truth: dict[str, NDArray[np.float32]]
    up: Array

    @staticmethod
    def of(
        session: SessionSeries,
        truth: TruthFile,
        table: NameTable | None = None,
        offset_s: float | None = None,
    ) -> TruthComparison:
        """Finds the names, the unit, the offset and the transform.

        Args:
            table: Maps points to joints; the ready-made table that finds most if None.
            offset_s: Seconds to add to the truth's times; found from the motion if None.

        Raises:
            RecordingError: There is no S*, the truth has too few of the joints, another person or another
                movement, or does not overlap with the session.
            DeviceError: The table names a point that the truth does not have.
        """
        body, rows = session.body, session.rows
        if not np.isfinite(rows.fused).any():
            raise RecordingError(f"{session} has no S*: no frame shows a person after a calibration.")
        table = table or fitting_table(body, truth.labels)
        joints = truth.joints(body, table)
        metres, unit = _unit_of(rows.fused, joints, session, truth)
        path = replace(JointPath.of(truth.seconds, joints), metres=metres)
        del joints  # as large as the file
        b_in_a = np.concatenate([part.b_in_a.astype(np.float32) for part in rows.parts()])
        views = {
            "a": view_of(rows.time_ns, rows.positions_a),
            "b": view_of(rows.time_ns + rows.skew_ns, b_in_a),
            "fused": view_of(rows.time_ns, rows.fused),
        }
        files = f"{truth.name} and {session}"
        match = partial(_match, body, views, files, table.name, offset_s)
        try:
            offset, common, true, fit, residual = match(path)
        except RecordingError:
            variants = {
                "a mirror image: its axes are left-handed": lambda at: at * _MIRROR,
                "of a person whose left and right are exchanged": lambda at: at[:, body.mirror],
            }
            for words, change in variants.items():
                try:
                    if match(path.changed(change)).offset.correlation < _NAMED:
                        continue
                except RecordingError:
                    continue
                raise RecordingError(f"{files}: the truth is {words}.") from None
            raise
        return TruthComparison(
            body=body,
            truth_name=truth.name,
            table=table.name,
            joints=np.flatnonzero(np.isfinite(path.at).any(axis=(0, 2))),
            unit=unit,
            offset=offset,
            a_from_truth=fit,
            residual=residual,
            frame=rows.frame[common],
            time_ns=rows.time_ns[common],
            found={key: view.positions[common] for key, view in views.items()},
            truth={key: fit.apply(true.pop(key)).astype(np.float32) for key in SKELETONS},
            up=session.up,
        )

    def __len__(self) -> int:
        return len(self.frame)

    @cached_property
    def distance(self) -> dict[str, Array]:
        """(T, J) of each skeleton to the truth, metres; NaN where either is unknown."""
        return {key: _length(self.found[key] - self.truth[key]) for key in SKELETONS}

    @property
    def distance_as_filed(self) -> float | None:
        """Metres between S* and the truth without the fit, the mean; None if the file is not in K_A's frame.

        It is if the fit moves the truth by 0.3 m at most. So much of the error of S* may be in the fit.
        """
        back, truth = self.a_from_truth.inverse(), self.truth["fused"]
        filed = np.concatenate([back.apply(truth[part]).astype(np.float32) for part in parts(len(self))])
        if np.nanmedian(_length(filed - self.truth["fused"])) > _OWN_FRAME:
            return None
        return float(np.nanmean(_length(filed - self.found["fused"])))

    def mean_distance(self, key: str) -> Array:
        """(T,) of a skeleton to the truth, mean over the joints that both have, metres; NaN without any."""
        known = np.isfinite(self.distance[key])
        count = known.sum(axis=1)
        total = np.where(known, self.distance[key], 0.0).sum(axis=1)
        return np.asarray(np.where(count > 0, total / np.maximum(count, 1), np.nan))

    @cached_property
    def angles(self) -> dict[str, tuple[Array, Array]]:
        """(T, K) angles of each skeleton and of the truth, degrees, of
        :data:`fusion.movement.angles.ANGLES`."""
        found, truth = self.found, self.truth
        return {
            key: (joint_angles(self.body, found[key], self.up), joint_angles(self.body, truth[key], self.up))
            for key in SKELETONS
        }

    @cached_property
    def _rest(self) -> dict[str, tuple[Array, Array]]:
        """(J, 3) constant part, and (T, J) length of the rest."""
        turns = rotations_of(self.body, self.found["fused"], self.time_ns)
        found = {key: (np.empty((turns.shape[1], 3)), np.full(turns.shape[:2], np.nan)) for key in SKELETONS}
        for joint in range(len(self.body)):  # all of a long session take gigabytes
            known = np.isfinite(turns[:, joint]).all(axis=1)
            frames = Rotation.from_quat(turns[known, joint])
            for key, (constant, rest) in found.items():
                off = self.found[key][known, joint] - self.truth[key][known, joint]
                own = frames.apply(off, inverse=True)
                constant[joint] = median_of_known(own.T)
                rest[known, joint] = _length(own - constant[joint])
        return found

    @property
    def constant(self) -> dict[str, Array]:
        """(J, 3) of each skeleton: the part of its distance to the truth that is common to all frames.

        It is the median of found minus true in the frame of the bone of S* that ends in the joint (x to the
        person's left, y down, z to the back, of a person upright with hanging arms): a different definition
        of the joint, rather than a tracking error.
        """
        return {key: constant for key, (constant, _) in self._rest.items()}

    @property
    def rest(self) -> dict[str, Array]:
        """(T, J) distance of each skeleton to the truth without the constant part, metres."""
        return {key: rest for key, (_, rest) in self._rest.items()}


def _unit_of(
    fused: Array, joints: NDArray[np.float32], session: SessionSeries, truth: TruthFile
) -> tuple[float, str]:
    """Metres per unit of the truth, and the unit's name: the person has the same size as S*."""
    ratio = float(np.nanmedian(_spans(fused) / _spans(joints)))
    metres, words = min(METRES.values(), key=lambda unit: abs(np.log(ratio / unit[0])))
    factor = max(ratio / metres, metres / ratio)
    if not factor < _SIZE_WITHIN:
        raise RecordingError(
            f"The person of {truth.name}, in {words}, has {metres / ratio:.2g} times the size of that of "
            f"{session}. Is the table of names right?"
        )
    return metres, words


def _spans(joints: NDArray[np.floating]) -> Array:
    """(J, J) median distance between two joints; NaN where unknown."""
    some = joints[:: max(1, len(joints) // 200)]
    spans = np.linalg.norm(some[:, :, None] - some[:, None], axis=3)
    spans[spans == 0.0] = np.nan
    known = np.isfinite(spans).any(axis=0)
    median = np.full(known.shape, np.nan)
    median[known] = np.nanmedian(spans[:, known], axis=0)
    return median


class _Match(NamedTuple):
    """How a truth lies in time and space."""

    offset: TimeOffset
    common: NDArray[np.int64]  # frames of the session
    true: dict[str, NDArray[np.float32]]  # the truth in its own frame, as in TruthComparison
    fit: RigidTransform
    residual: float


def _match(
    body: Body,
    views: dict[str, View],
    files: str,
    table: str,
    offset_s: float | None,
    path: JointPath,
) -> _Match:
    """Raises RecordingError where the truth is no truth of the session."""
    timed = path_of(path)
    offset = find_offset(body, (views["a"], views["b"]), views["fused"], path)
    if offset_s is not None:
        offset = offset.given(offset_s) if offset else TimeOffset.stated(offset_s, timed.first_ns)
        offset = replace(offset, correlation=correlation_at(views["fused"], timed, offset.clock))
    elif offset is None:
        raise RecordingError(
            f"{files}: no offset in time makes the movements match. Do they show the same movement of a "
            f"person who moves enough, and is the table of names, {table}, right? `offset` gives an offset."
        )
    elif not offset.sure:
        raise RecordingError(f"{files}: the person moves too little to find the offset; give `offset`.")
    times = {key: view.time_ns + offset.clock.at(view.time_ns) for key, view in views.items()}
    true = {key: timed.positions(at).astype(np.float32) for key, at in times.items()}
    common = np.flatnonzero(np.isfinite(views["fused"].positions + true["fused"]).any(axis=(1, 2)))
    if len(common) < _FEWEST_FRAMES:
        raise RecordingError(
            f"{files} have {len(common)} frames with an S* in common, at an offset of "
            f"{offset.seconds:.3f} s: too few to compare."
        )
    true = {key: true.pop(key)[common] for key in SKELETONS}
    some = slice(None, None, max(1, len(common) // _MOST_FITTED))
    p = np.stack([views[key].positions[common[some]] for key in SKELETONS]).astype(np.float64)
    q = np.stack([true[key][some] for key in SKELETONS]).astype(np.float64)
    try:
        fit = fit_recording(p, q)
        residual, mirrored = (
            float(np.nanmedian(_length(p[-1] - one.apply(at))))
            for one, at in ((fit, q[-1]), (fit_recording(p, q * _MIRROR), q[-1] * _MIRROR))
        )
    except CalibrationError as error:
        raise RecordingError(f"{files}: {error}") from None
    if residual > _LARGEST_RESIDUAL or mirrored < _MIRRORED * residual:
        raise RecordingError(
            f"{files} are {residual * 1e3:.0f} mm apart (median) after the best fit: not the same movement, "
            "or another table of names is needed."
        )
    return _Match(offset, common, true, fit, residual)


def _length(vectors: NDArray[np.floating]) -> Array:
    return np.asarray(np.linalg.norm(vectors, axis=-1))
