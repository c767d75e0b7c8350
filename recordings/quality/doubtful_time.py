"""For how long a session is doubtful: the views are apart, a limb is uncertain, a view is missing."""

import numpy as np
from numpy.typing import NDArray

from recordings.appearance.joint_trust import SeenJoints
from recordings.data.session_arrays import SessionArrays
from recordings.quality.limits import USABLE

UNCERTAIN = 150.0
"""Millimetres of a wrist or ankle, one standard deviation."""
LIMBS = {
    f"{side} {limb}": f"{end}{side.title()}"
    for limb, end in (("arm", "Wrist"), ("leg", "Ankle"))
    for side in ("left", "right")
}
_LONGEST = 3.0  # frames, of the median one: what is longer is a gap


def seen_people(rows: SessionArrays) -> NDArray[np.bool_]:
    """(2, T) whether somebody is in the newest frame of A and of B."""
    seen = np.zeros((2, len(rows)), dtype=bool)
    a, b, at = SeenJoints(len(rows.body)), SeenJoints(len(rows.body)), 0
    for part in rows.parts():
        of_a = a.add(part.states_a, part.clock_a, part.time_ns)
        of_b = b.add(part.states_b, part.clock_b, part.time_ns)
        seen[:, at : (at := at + len(part))] = of_a.any(axis=1), of_b.any(axis=1)
    return seen


def time_of_frames(rows: SessionArrays) -> NDArray[np.float64]:
    """(T,) seconds until the next frame, or three usual ones: what is longer is a gap."""
    lasts = np.diff(rows.time_ns) * 1e-9
    frame = float(np.median(lasts)) if len(lasts) else 0.0
    return np.append(lasts, frame).clip(max=_LONGEST * frame)


def uncertain_limbs(rows: SessionArrays) -> NDArray[np.bool_]:
    """(T, 4) whether the end of each of :data:`LIMBS` is uncertain; false where it was never seen."""
    ends = [rows.body.joint(end) for end in LIMBS.values()]
    return (1e3 * rows.filled("sigma")[:, ends] > UNCERTAIN) & ~rows.never_seen[ends]


def doubtful_seconds(
    rows: SessionArrays, apart: NDArray[np.float64], seen: NDArray[np.bool_]
) -> dict[str, float | str | None]:
    """How long each doubt lasts, in seconds; None if unknown.

    ``all`` is how long the session lasts, without gaps; ``limb`` is uncertain for longest. A wrist or ankle
    that was never seen is not uncertain but missing.

    Args:
        apart: (N,) metres between the views in the last frames, those since the calibration.
        seen: (2, T) of :func:`seen_people`.
    """
    lasts = time_of_frames(rows)
    figures: dict[str, float | str | None] = {
        "all": float(lasts.sum()),
        "views_apart": None,
        "limb_uncertain": None,
        "limb": None,
        "one_view": float(lasts[seen[0] != seen[1]].sum()),
    }
    if np.isfinite(apart).any():
        figures["views_apart"] = float(lasts[len(lasts) - len(apart) :][1e3 * apart > USABLE].sum())
    if rows.sigma is not None:
        uncertain = uncertain_limbs(rows)
        figures["limb_uncertain"] = float(lasts[uncertain.any(axis=1)].sum())
        if uncertain.any():
            figures["limb"] = list(LIMBS)[int((lasts @ uncertain).argmax())]
    return figures
