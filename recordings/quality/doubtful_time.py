"""For how long S* is doubtful, of the time in which somebody is seen, and for how long nobody is."""

import numpy as np
from numpy.typing import NDArray

from devices.findings.rules import of_error, of_views
from recordings.appearance.joint_trust import SeenJoints
from recordings.data.session_arrays import SessionArrays

UNCERTAIN = 150.0
"""Millimetres of a wrist or ankle, one standard deviation."""
LIMBS = {
    f"{side} {limb}": f"{end}{side.title()}"
    for limb, end in (("arm", "Wrist"), ("leg", "Ankle"))
    for side in ("left", "right")
}
DOUBTS = ("one_view", "limb_uncertain", "uncertain")
"""What makes a moment doubtful: one view is alone; a limb, or all of S*, is uncertain."""
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


def expected_error(rows: SessionArrays) -> NDArray[np.float64]:
    """(T,) millimetres, the mean standard deviation of the joints that were ever seen; NaN without S*."""
    seen = ~rows.never_seen
    return np.asarray(1e3 * rows.filled("sigma").mean(axis=1, where=seen if seen.any() else True))


def doubts_of(rows: SessionArrays, first: int, seen: NDArray[np.bool_]) -> dict[str, NDArray[np.bool_]]:
    """(T,) whether each of :data:`DOUBTS` holds. Before the frame `first` the views are not compared.

    All of S* is uncertain where its expected error is not usable; for methods that do not estimate it, where
    the distance between the views is not.

    Args:
        seen: (2, T) of :func:`seen_people`.
    """
    someone, compared = seen.any(axis=0), np.arange(len(rows)) >= first
    known = rows.sigma is not None
    off_mm = expected_error(rows) if known else 1e3 * rows.disagreement
    limits = (of_error if known else of_views)(rows.body.name)
    found = (
        seen[0] != seen[1],
        uncertain_limbs(rows).any(axis=1) & someone,
        (off_mm > limits.usable[1]) & someone & compared,
    )
    return dict(zip(DOUBTS, found, strict=True))


def doubtful_seconds(
    rows: SessionArrays, first: int, seen: NDArray[np.bool_]
) -> dict[str, float | str | None]:
    """How long each doubt lasts, in seconds; None if unknown.

    ``all`` is how long the session lasts, ``seen`` how long somebody is in view, ``doubtful`` how long any
    doubt of :data:`DOUBTS` lasts; ``limb`` is uncertain for longest. A wrist or ankle that was never seen is
    not uncertain but missing.

    Args:
        first: The first frame at which the distance of the views counts.
        seen: (2, T) of :func:`seen_people`.
    """
    lasts, doubts = time_of_frames(rows), doubts_of(rows, first, seen)
    figures: dict[str, float | str | None] = {
        "all": float((rows.time_ns[-1] - rows.time_ns[0]) * 1e-9 + lasts[-1]),
        "seen": float(lasts[seen.any(axis=0)].sum()),
        "doubtful": float(lasts[np.any(list(doubts.values()), axis=0)].sum()),
        **{name: float(lasts[each].sum()) for name, each in doubts.items()},
        "limb": None,
    }
    if rows.sigma is None:
        figures["limb_uncertain"] = None
    elif (uncertain := uncertain_limbs(rows)).any():
        figures["limb"] = list(LIMBS)[int((lasts @ uncertain).argmax())]
    return figures
