"""Sessions in users' own tests: ``examples/test_fusion.py`` shows it.

The module is imported by every run of pytest (:mod:`recordings.pytest_plugin`), so it imports no more than it
needs until a function is called.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from fusion.errors import DuplexError
from recordings.errors import RecordingError, UnknownNameError

if TYPE_CHECKING:
    from devices.simulated.kinect import Movement
    from fusion.compiling.first_run import Progress
    from fusion.setup import FuserSettings
    from recordings.session import Session

_MOST_SECONDS = 10  # that are listed

tell_first_run: Callable[[Progress], object] | None = None
"""Is told how far :func:`simulated_session` has compiled kernels; the plugin prints it between the tests."""
update_expected = False
"""Whether :func:`assert_sessions_match` writes the expected file; ``pytest --duplex-update`` sets it."""
written: list[Path] = []
"""The expected files that were written."""


class SessionsDifferError(DuplexError, AssertionError):
    """Two sessions differ, there is no expected one, or a session is not as good as it should be.

    Attributes:
        sessions: The actual one and, if there is one, the expected one.
        to_make: Whether the expected one is missing.
    """

    def __init__(self, message: str, *sessions: Session, to_make: bool = False) -> None:
        super().__init__(message)
        self.sessions, self.to_make = sessions, to_make


def assert_sessions_match(
    actual: Session | str | Path,
    expected: Session | str | Path,
    *,
    position_mm: float = 0.01,
    joints_mm: Mapping[str, float] | None = None,
) -> None:
    """Fails if two sessions are of different captures or S* differs; says which joints, and by how much.

    Two sessions are of the same capture if their frames have equal times and tracking states, and joints of
    S_A and S_B within the tolerance. If `expected` is a file, ``pytest --duplex-update`` writes it
    instead of comparing.

    Args:
        actual, expected: Sessions or their files.
        position_mm: Tolerance for the distance of a joint, millimetres. The default allows for rounding that
            differs between processors and versions of libraries, and is far below the noise of any sensor; 0
            requires bit-identical values.
        joints_mm: Other tolerances for some joints, by name: ``{"WRIST_LEFT": 5.0}``.

    Raises:
        SessionsDifferError: An AssertionError. The body, the number of frames, the times or states differ;
            a skeleton is missing in one session; a joint exceeds the tolerance; or there is no expected file.
        RecordingError: A file cannot be read, a name in `joints_mm` is not a joint's, or a tolerance is
            negative or not a number.
    """
    __tracebackhide__ = True
    from recordings.comparing.session_differences import differences
    from recordings.session import Session

    joints_mm = joints_mm or {}
    for name, mm in {"position_mm": position_mm, **joints_mm}.items():
        if not 0.0 <= mm < float("inf"):
            raise RecordingError(f"{name} is {mm}; it must be 0 or more millimetres.")
    one = actual if isinstance(actual, Session) else _opened(actual)
    if not isinstance(expected, Session):
        if update_expected:
            _write(one, Path(expected))
        elif not Path(expected).exists():
            missing = f"There is no {expected}; pytest --duplex-update makes it."
            raise SessionsDifferError(missing, one, to_make=True)
    two = expected if isinstance(expected, Session) else _opened(expected)
    if found := "\n".join(differences(one, two, position_mm, joints_mm)):
        raise SessionsDifferError(found, one, two)


def assert_session(
    session: Session | str | Path,
    *,
    verdict: Literal["good", "usable"] | None = "good",
    bones_mm: float | None = 1e-3,
    gap_s: float | None = None,
) -> None:
    """Fails if a session is not good; says why, and which seconds are bad.

    Args:
        session: A session or its file.
        verdict: The worst :attr:`recordings.Session.verdict` that passes; None: any.
        bones_mm: The largest error of a bone of S*, millimetres; None: any. The default is above the
            resolution of float32 and the errors of the methods ``duplex`` and ``paper``.
        gap_s: The longest time without S*, seconds, also at both ends; None: any.

    Raises:
        SessionsDifferError: An AssertionError. The session is not as asked for, or its file is damaged.
        RecordingError: The file cannot be read, or `verdict` is not one of those words.
    """
    __tracebackhide__ = True
    from recordings.session import Session

    if verdict not in ("good", "usable", None):
        raise UnknownNameError("verdict", verdict, ("good", "usable"))
    one = session if isinstance(session, Session) else _opened(session)
    if found := "\n".join(_shortcomings(one, verdict, bones_mm, gap_s)):
        raise SessionsDifferError(found, one)


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

    The true joints are ``session.truth``, (T, J, 3) metres in K_A's frame.

    Args:
        movement: A movement of the library (``duplex demo --motion list``), a BVH file, or a movement.
        seconds: Duration; the registration is found from the first frames.
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
    from devices.people.recorded_people import RecordedPeople
    from devices.recorded.two_recordings import TwoRecordings
    from devices.sensor import DeviceError
    from devices.simulated.kinect import compile_tracking, simulated_pair
    from fusion.body import BODIES
    from fusion.compiling.first_run import FirstRun
    from fusion.setup import FuserSettings
    from recordings.fusing.files import fuse_read, recording_warm_ups
    from recordings.session import Session

    if body not in BODIES:
        raise DeviceError(f"There is no body {body!r}. Choose one of {', '.join(BODIES)}.")
    settings = settings or FuserSettings(hindsight="labels")
    with FirstRun(*recording_warm_ups(settings, compile_tracking), tell=tell_first_run) as first_run:
        first_run.finish(load=False)
    sensors = simulated_pair(
        motion=movement, seed=seed, body=BODIES[body], angle_deg=angle_deg, seconds=seconds
    )
    a, b, truth = sensors
    people = (RecordedPeople.of(sensor.body, sensor.frames()) for sensor in (a, b))
    view_a, view_b = (each.view(each.ids) for each in people)
    pairing = pair_views(a.body, view_a, view_b, every_frame=settings.method == "duplex")
    read = TwoRecordings(a.body, pairing, (a.intrinsics, b.intrinsics), ())
    session = Session.of(*fuse_read(read, (a.name, b.name), settings))
    true = truth.positions_at(pairing.pairs.skeletons.time_ns)
    return replace(session, rows=replace(session.rows, truth=true))


def _shortcomings(
    session: Session, word: str | None, bones_mm: float | None, gap_s: float | None
) -> Iterator[str]:
    """What is not as asked for, a line each."""
    import numpy as np

    found = session.verdict
    if session.damage is not None:
        yield f"{session}: {session.damage}"
    if word is not None and found.word not in ("good", word):
        yield f"{session} is {found.word}; asked for was {word}."
        yield from (f"  {each.word}: {each.reason}" for each in found.findings)
        poor = [each for each in session.quality_per_second if each.word != "good"]
        yield from (f"  {each.start:g} s {each.word}: {each.reason}" for each in poor[:_MOST_SECONDS])
        if len(poor) > _MOST_SECONDS:
            yield f"  and {len(poor) - _MOST_SECONDS} more seconds"
    error = session.quality.bone_error * 1e3
    if bones_mm is not None and (error > bones_mm).any():
        t = int(np.nanargmax(error))
        yield f"a bone of S* is {error[t]:.3g} mm off in frame {t}; asked for was {bones_mm:g} mm"
    present = session.time[np.isfinite(session.fused).all(axis=(1, 2))]
    known = np.concatenate((session.time[:1], present, session.time[-1:]))
    if gap_s is not None and (longest := float(np.diff(known).max())) > gap_s:
        begin = known[int(np.diff(known).argmax())]
        yield f"there is no S* for {longest:.2f} s from {begin:.2f} s on; asked for was {gap_s:g} s"


def _opened(path: str | Path) -> Session:
    """The session of a file; an error shows no frames of this package."""
    __tracebackhide__ = True
    from recordings.session import Session

    try:
        return Session.open(path)
    except RecordingError as error:
        raise error.with_traceback(None) from None


def _write(session: Session, path: Path) -> None:
    """Writes a session whole or not at all."""
    path.parent.mkdir(parents=True, exist_ok=True)
    session.save(path)
    written.append(path.absolute())
