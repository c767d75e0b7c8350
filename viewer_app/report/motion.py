"""The motion of S_A, S_B and S* as compact data for the player in a page, ``templates/player.js``."""

import zlib
from base64 import b64encode
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from recordings.appearance.floor import floor_under
from recordings.quality.doubtful_time import UNCERTAIN
from recordings.session import Session

_MOST_BYTES = 650_000  # a page may have 1.5 MB, and the plots need most of the rest
_FPS = 15.0
_MOST_FRAMES = 9000  # ten minutes
_AROUND = 1.5  # seconds before and after an event in which frames are left out last
_UNSEEN = -32768


def encoded_motion(session: Session, moments: Sequence[float]) -> dict[str, object]:
    """The skeletons over time as what the canvas of the player takes, by the name of its ``data-`` attribute.

    At most 15 frames per second are kept, and fewer of a long session: half of them near its events.

    Args:
        moments: Seconds of the events.

    Returns:
        ``motion``: base64 of a zlib stream: seconds, (T,) float32; then of positions in the floor's frame,
        (3, J, 3, T) int16 millimetres, the differences from frame to frame in zigzag code, first all low
        bytes, then all high bytes. A joint that was not seen, of S* one that was never seen, is -32768. Last,
        (J, T) bits, the highest first, whether a joint of S* is uncertain or has no data.
        ``frames``: T. ``parents``: of the joints. ``sensors``: (2, 3) positions of A and B in metres.
    """
    rows = session.rows
    floor = floor_under(rows).inverse()
    skeletons = np.stack((rows.positions_a, rows.b_in_a, rows.seen)).astype(np.float64)
    seconds, uncertain = rows.time_ns * 1e-9, rows.predicted | (1e3 * rows.filled("sigma") > UNCERTAIN)
    most = _MOST_FRAMES
    while True:
        kept = _kept_frames(seconds, moments, most)
        places = floor.apply(skeletons[:, kept])
        data = b64encode(_packed(seconds[kept], places, uncertain[kept])).decode()
        if len(data) <= _MOST_BYTES:
            break
        most = int(0.95 * len(kept) * _MOST_BYTES / len(data))
    sensors = floor.apply(np.stack((np.zeros(3), rows.translation[-1])))
    return {
        "motion": data,
        "frames": len(kept),
        "parents": list(session.body.parents),
        "sensors": sensors.round(3).tolist(),
    }


def _kept_frames(seconds: NDArray[np.floating], moments: Sequence[float], most: int) -> NDArray[np.intp]:
    """The indices of at most so many frames, in order: half of those that are too many are near no event."""
    wanted = np.arange(0.0, seconds[-1] + 1.0 / _FPS, 1.0 / _FPS)
    kept = np.unique(np.searchsorted(seconds, wanted - 1e-4).clip(max=len(seconds) - 1))
    if len(kept) <= most:
        return kept
    near = np.zeros(len(kept), dtype=bool)
    for moment in moments:
        near |= np.abs(seconds[kept] - moment) <= _AROUND
    close, others = _thinned(kept[near], most // 2), kept[~near]
    return np.sort(np.concatenate((close, _thinned(others, most - len(close)))))


def _thinned(frames: NDArray[np.intp], most: int) -> NDArray[np.intp]:
    """At most so many of the frames, evenly."""
    return frames if len(frames) <= most else frames[np.linspace(0, len(frames) - 1, most).astype(np.intp)]


def _packed(
    seconds: NDArray[np.floating], positions: NDArray[np.floating], uncertain: NDArray[np.bool_]
) -> bytes:
    """The zlib stream of (T,) seconds, (3, T, J, 3) metres, and (T, J) whether a joint is uncertain."""
    millimetres = np.clip(positions.transpose(0, 2, 3, 1) * 1e3, -32767.0, 32767.0)
    series = np.where(np.isfinite(millimetres), millimetres.round(), _UNSEEN).astype(np.int16)
    steps = np.diff(series, axis=-1, prepend=np.int16(0))  # modulo 2^16
    codes = ((steps << 1) ^ (steps >> 15)).ravel().astype("<i2")
    halves = codes.view(np.uint8).reshape(-1, 2)
    parts = seconds.astype("<f4"), halves[:, 0], halves[:, 1], np.packbits(uncertain.T)
    return zlib.compress(b"".join(part.tobytes() for part in parts))
