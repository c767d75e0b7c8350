"""A recording of ROS 2 in one file, .mcap: written without ROS, played by ``ros2 bag play``.

:mod:`recordings.export.ros_messages` has the topics. A file is read by Foxglove, PlotJuggler and Rerun, too.
"""

import copy
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from devices.events import Event
from fusion.body import Body
from fusion.rigid import RigidTransform
from fusion.setup import FusionSetup
from recordings.appearance.floor import floor_under
from recordings.data.layout import NO_FRAME
from recordings.errors import RecordingError
from recordings.export.ros_messages import TOPICS, RosFrame, RosMessages, definition
from recordings.session_series import SessionSeries

_CHUNK = 4_000_000  # bytes, a quarter of a minute
_LATCHED = """\
- history: keep_last
  depth: 1
  reliability: reliable
  durability: transient_local
  deadline: {sec: 9223372036, nsec: 854775807}
  lifespan: {sec: 9223372036, nsec: 854775807}
  liveliness: automatic
  liveliness_lease_duration: {sec: 9223372036, nsec: 854775807}
  avoid_ros_namespace_conventions: false
"""
"""How a topic is offered whose last message those get who come later."""


def write_mcap(session: SessionSeries, path: Path) -> str:
    """Writes S*, its angles and the events of a session, at their recorded times.

    Raises:
        RecordingError: No frame has an S*.
    """
    rows, seen, unix_ns = session.rows, ~session.rows.never_seen, capture_times(session)
    if not np.isfinite(rows.fused[:, session.body.root]).any():
        raise RecordingError(f"{session} has no frame with an S*; there is nothing to export.")
    floor, events, at = floor_under(rows), session.events, 0
    rotations, stamps = session.rotations.quaternions, rows.time_ns if unix_ns is None else unix_ns
    placed = np.zeros(len(rows), dtype=bool)
    for setup, own in session.setups():
        placed[own] = is_placed(setup)
    angles = np.stack([session.angles[name] for name in session.angles], axis=1)
    with path.open("wb") as file:
        mcap = McapFile(file, session.body)
        for k, time_ns in enumerate(stamps.tolist()):
            covariance = None if rows.sigma is None else even_covariance(rows.sigma[k])
            a_from_b = RigidTransform(rows.rotation[k], rows.translation[k]) if placed[k] else None
            mcap.write(
                RosFrame(time_ns, rows.fused[k], rotations[k], seen, covariance, angles[k], a_from_b, floor)
            )
            # those of frames that are lost, at the end of a damaged file, come last
            while at < len(events) and (events[at].frame <= k or k == len(rows) - 1):
                mcap.event(max(time_ns + events[at].time_ns - int(rows.time_ns[k]), 0), events[at])
                at += 1
        mcap.finish()
    since = "" if unix_ns is not None else ", since the first frame: the session does not say when it was"
    return f"{len(rows)} frames at their recorded times{since}"


def capture_times(session: SessionSeries) -> NDArray[np.int64] | None:
    """(T,) when the frames were captured, nanoseconds since 1970 UTC; None if that is not known.

    Of live sensors these are the times that live outputs had.
    """
    told = session.rows.filled("unix_ns")
    if (told != NO_FRAME).all():
        return told
    return None if session.first_unix_ns is None else session.first_unix_ns + session.time_ns


def is_placed(setup: FusionSetup) -> bool:
    """Whether B's place is measured, not that of a calibration without data."""
    return not setup.calibration.provisional or setup.calibration.registration is not None


def even_covariance(sigma: NDArray[np.floating]) -> NDArray[np.float64]:
    """(J, 3, 3) m² of (J,) standard deviations of the distance to the truth, alike in all directions."""
    return np.asarray(sigma.astype(np.float64)[:, None, None] ** 2 / 3.0 * np.eye(3))


class McapFile:
    """Writes messages of one body to a file, which the caller closes."""

    def __init__(self, file: Any, body: Body) -> None:
        self._messages = RosMessages(body)
        from mcap.writer import Writer

        self._writer = Writer(file, chunk_size=_CHUNK)
        self._writer.start(profile="ros2", library="duplex-kinects")
        self._channels: dict[str, int] = {}
        schemas: dict[str, int] = {}
        for topic, kind in TOPICS.items():
            if kind not in schemas:
                schemas[kind] = self._writer.register_schema(kind, "ros2msg", definition(kind).encode())
            qos = {"offered_qos_profiles": _LATCHED if topic == "/tf_static" else ""}
            self._channels[topic] = self._writer.register_channel(topic, "cdr", schemas[kind], qos)
        self._begun = False

    def write(self, frame: RosFrame) -> None:
        """Adds the messages of a frame."""
        if not self._begun:
            self._begun = True
            for topic, data in self._messages.constant(frame.time_ns):
                self._add(topic, frame.time_ns, data)
        for topic, data in self._messages.of_frame(frame):
            self._add(topic, frame.time_ns, data)

    def event(self, time_ns: int, event: Event) -> None:
        """Adds an event."""
        topic, data = self._messages.event(time_ns, event)
        self._add(topic, time_ns, data)

    def ending(self, file: Any, of: Any) -> None:
        """Writes to `of` what would make the file whole if nothing followed; the file itself stays open.

        Args:
            file: That of :meth:`__init__`.
            of: Tells with ``tell()`` where the file's next byte goes.
        """
        copy.deepcopy(self._writer, {id(file): of}).finish()  # type: ignore[no-untyped-call]

    def finish(self) -> None:
        """Writes the index."""
        self._writer.finish()  # type: ignore[no-untyped-call]

    def _add(self, topic: str, time_ns: int, data: bytes) -> None:
        self._writer.add_message(self._channels[topic], time_ns, data, time_ns)
