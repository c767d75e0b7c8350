"""Sessions in users' own tests: ``examples/test_fusion.py`` shows it.

The module is imported by every run of pytest (:mod:`recordings.pytest_plugin`), so it imports no more than it
needs until a function is called.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from devices.simulated.kinect import Movement
    from fusion.setup import FuserSettings
    from recordings.session import Session

_CAPTURED = {
    "time_ns": "the time since the first pair",
    "skew_ns": "the skew between A and B",
    "clock_a": "the time of A",
    "clock_b": "the time of B",
    "states_a": "a tracking state of S_A",
    "states_b": "a tracking state of S_B",
}
"""Data shared by two fusions of one capture, by name in :class:`recordings.session_arrays.SessionArrays`."""
_SKELETONS = {"S_A": "positions_a", "S_B": "positions_b", "S*": "fused"}
_MOST_JOINTS = 6  # of a skeleton in the table

update_expected = False
"""Whether :func:`assert_sessions_match` writes the expected file; ``pytest --duplex-update`` sets it."""
written: list[Path] = []
"""The expected files that were written."""


class SessionsDifferError(AssertionError):
    """Two sessions differ, or there is no expected one.

    Attributes:
        sessions: The actual one and, if there is one, the expected one.
    """

    def __init__(self, message: str, *sessions: Session) -> None:
        super().__init__(message)
        self.sessions = sessions


def assert_sessions_match(
    actual: Session | str | Path, expected: Session | str | Path, *, position_mm: float = 0.01
) -> None:
    """Fails if two sessions are of different captures or S* differs; says which joints, and by how much.

    Two sessions are of the same capture if their frames have equal times and tracking states, and joints of
    S_A and S_B within the tolerance. ``pytest --duplex-update`` writes `expected`, where it is a file,
    instead of comparing.

    Args:
        actual, expected: Sessions or their files.
        position_mm: Tolerance for the distance of a joint, millimetres. The default allows for rounding that
            differs between processors and versions of libraries, and is far below the noise of any sensor; 0
            requires bit-identical values.

    Raises:
        SessionsDifferError: An AssertionError. The body, the number of frames, the times or states differ;
            a skeleton is missing in one session; a joint exceeds the tolerance; or there is no expected file.
        RecordingError: A file cannot be read.
        ValueError: `position_mm` is negative or not a number.
    """
    __tracebackhide__ = True
    from recordings.session import Session

    if not 0.0 <= position_mm < float("inf"):
        raise ValueError(f"position_mm is {position_mm}; it must be 0 or more millimetres")
    one = actual if isinstance(actual, Session) else _opened(actual)
    if not isinstance(expected, Session):
        if update_expected:
            _write(one, Path(expected))
        elif not Path(expected).exists():
            raise SessionsDifferError(f"There is no {expected}; pytest --duplex-update makes it.", one)
    two = expected if isinstance(expected, Session) else _opened(expected)
    differences = "\n".join(_differences(one, two, position_mm))
    if differences:
        raise SessionsDifferError(differences, one, two)


def simulated_session(
    movement: str | Path | Movement = "walk",
    seconds: float = 4.0,
    seed: int = 0,
    *,
    body: str = "azure_kinect",
    angle_deg: float = 90.0,
    settings: FuserSettings | None = None,
) -> Session:
    """Fuses two simulated sensors that watch one person; the same arguments give the same session.

    The true joints are ``session.rows.truth``, (T, J, 3) metres in K_A's frame.

    Args:
        movement: A movement of the library (``duplex demo --motion list``), a BVH file, or a movement.
        seconds: Duration; the first frames are the ones of which the registration is found.
        seed: Seed of the sensors' errors.
        body: Whose body tracker is simulated: ``kinect_v1``, ``kinect_v2``, ``azure_kinect``, ``blazepose``.
        angle_deg: Between the sensors.
        settings: Settings of the method.

    Raises:
        DeviceError: There is no such movement or body, or the duration is not positive.
        FusionError: The views cannot be calibrated, as in a session of a few frames.
    """
    from dataclasses import replace

    from devices.pairing import pair_views
    from devices.people import RecordedPeople
    from devices.sensor import DeviceError
    from devices.simulated.kinect import simulated_pair
    from devices.two_recordings import TwoRecordings
    from fusion.body import BODIES
    from fusion.setup import FuserSettings
    from recordings.fusing.files import fuse_read

    if body not in BODIES:
        raise DeviceError(f"There is no body {body!r}. Choose one of {', '.join(BODIES)}.")
    settings = settings or FuserSettings(hindsight="labels")
    sensors = simulated_pair(
        motion=movement, seed=seed, body=BODIES[body], angle_deg=angle_deg, seconds=seconds
    )
    a, b, truth = sensors
    people = (RecordedPeople.of(sensor.body, sensor.frames()) for sensor in (a, b))
    view_a, view_b = (each.view(each.ids) for each in people)
    pairing = pair_views(a.body, view_a, view_b, every_frame=settings.method == "duplex")
    read = TwoRecordings(a.body, pairing, (a.intrinsics, b.intrinsics), ())
    session = fuse_read(read, (a.name, b.name), settings)
    true = truth.positions_at(pairing.pairs.skeletons.time_ns)
    return replace(session, rows=replace(session.rows, truth=true))


def _opened(path: str | Path) -> Session:
    """The session of a file; an error shows no frames of this package."""
    __tracebackhide__ = True
    from recordings.errors import RecordingError
    from recordings.session import Session

    try:
        return Session.open(path)
    except RecordingError as error:
        raise error.with_traceback(None) from None


def _write(session: Session, path: Path) -> None:
    """Writes a session whole or not at all."""
    path.parent.mkdir(parents=True, exist_ok=True)
    partial = path.with_name(f".{os.getpid()}.{path.name}")
    session.save(partial)
    partial.replace(path)
    written.append(path.absolute())


def _differences(one: Session, two: Session, position_mm: float) -> Iterator[str]:
    """What differs, a line each; nothing if the sessions match."""
    import numpy as np

    damage = [f"{session}: {session.damage}" for session in (one, two) if session.damage is not None]
    if one.body is not two.body:
        yield f"{one} is of {one.body.name}, {two} of {two.body.name}"
    elif len(one) != len(two):
        yield f"{one} has {len(one)} frames, {two} has {len(two)}"
    yield from damage
    if damage or one.body is not two.body or len(one) != len(two):
        return
    for name, what in _CAPTURED.items():
        differ = (getattr(one.rows, name) != getattr(two.rows, name)).reshape(len(one), -1).any(axis=1)
        for t in np.flatnonzero(differ)[:1]:
            yield f"frame {t}: {what} differs; the sessions are of different captures"
    apart = {
        name: _apart_mm(getattr(one.rows, rows), getattr(two.rows, rows)) for name, rows in _SKELETONS.items()
    }
    beyond = {name: mm > position_mm for name, mm in apart.items()}
    for name, differ in beyond.items():
        for t in np.flatnonzero(differ.any(axis=1))[:1]:
            yield (
                f"{name} differs by more than {position_mm:g} mm in {differ.any(axis=1).sum()} of {len(one)} "
                f"frames, first in frame {t}, {one.body.joints[int(differ[t].argmax())]}"
                + ("" if name == "S*" else "; the sessions are of different captures")
            )
    if any(differ.any() for differ in beyond.values()):
        yield from ("", _HEAD)
        for name, mm in apart.items():
            yield from _rows(name, one.body.joints, mm, beyond[name])
    elif position_mm == 0.0:
        for t in np.flatnonzero(one.fused_checksums != two.fused_checksums)[:1]:
            yield f"frame {t}: S* differs, by less than float32 shows"


def _apart_mm(one: NDArray[Any], two: NDArray[Any]) -> NDArray[np.float64]:
    """(T, J) millimetres between (T, J, 3) positions as files store them, in float32.

    0 where both are missing, infinite where one is.
    """
    import numpy as np

    stored = (each.astype(np.float32).astype(np.float64) for each in (one, two))
    mm = np.linalg.norm(np.subtract(*stored), axis=2) * 1e3
    missing = [np.isnan(each).any(axis=2) for each in (one, two)]
    return np.where(missing[0] & missing[1], 0.0, np.where(missing[0] | missing[1], np.inf, mm))


_TABLE = "{:8}  {:16} {:>6} {:>7} {:>10} {:>9} {:>11}"
_HEAD = _TABLE.format("skeleton", "joint", "frames", "missing", "largest mm", "median mm", "first frame")


def _rows(name: str, joints: tuple[str, ...], mm: NDArray[Any], beyond: NDArray[Any]) -> Iterator[str]:
    """The rows of a skeleton: all of its joints together, then those that are farthest apart.

    A joint is missing where only one session has it; the median is that of the differences.
    """
    import numpy as np

    of_joints = sorted(np.flatnonzero(beyond.any(axis=0)).tolist(), key=lambda j: -mm[:, j].max())
    if not of_joints:
        return
    shown = of_joints[:_MOST_JOINTS]
    for label, part in [("all joints", slice(None)), *((joints[j], slice(j, j + 1)) for j in shown)]:
        frames = np.flatnonzero(beyond[:, part].any(axis=1))
        missing = int(np.isinf(mm[:, part]).any(axis=1).sum())
        far = mm[:, part][beyond[:, part] & np.isfinite(mm[:, part])]
        figures = [f"{value:.3g}" for value in (far.max(), np.median(far))] if len(far) else ["–", "–"]
        yield _TABLE.format(name, label, len(frames), missing or "", *figures, frames[0])
    if len(of_joints) > len(shown):
        yield f"{name:8}  and {len(of_joints) - len(shown)} more joints"
