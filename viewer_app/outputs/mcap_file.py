"""A recording of ROS 2 while the loop runs: the messages of :mod:`recordings.export.ros_messages`."""

from pathlib import Path

import numpy as np

from devices.events import Event
from devices.output_file import GrowingOutput
from fusion.movement.joint_rotations import JointRotations
from fusion.setup import FusionSetup
from recordings.export.ros import McapFile, is_placed
from recordings.export.ros_messages import RosFrame
from viewer_app.errors import UsageError
from viewer_app.outputs.live_movement import LiveMovement
from viewer_app.outputs.output import LiveOutput
from viewer_app.sinks.item_queue import QueuedFrame

_KEEP = 1800  # frames: one minute without progress of the disk
_EVERY_NS = 2_000_000_000  # between two blocks
_AGAIN_S = 1.0  # until a block is tried again that could not be written


class McapOutput(LiveOutput):
    """Writes a block every two seconds. After each the file is whole, so that a killed process leaves one.
    :func:`recordings.export.check_packages` says whether it can be written."""

    closes_within = None
    keeps = True

    def __init__(self, path: Path, setup: FusionSetup, overwrite: bool) -> None:
        super().__init__(f"ROS 2 recording {path}", keep=_KEEP)
        self._path = path
        self._setup, self._written, self._due_ns = setup, 0, 0
        self._begun_ns = 0  # since 1970, where that is known
        self._early: list[Event] = []
        self._movement, self._rotations = LiveMovement(setup.body), JointRotations(setup.body)
        self._waiting = _Waiting()
        self._mcap = McapFile(self._waiting, setup.body)
        self._file = GrowingOutput(path, overwrite=overwrite, again=lambda _: self._queue.has_time(_AGAIN_S))
        self.start()

    def send_frame(self, frame: QueuedFrame) -> int:
        """Adds a frame, and once in a while writes what was added."""
        unix_ns, fused = frame.frame.unix_ns, frame.fused
        self._begun_ns = 0 if unix_ns is None else unix_ns - frame.time_ns
        angles, _ = self._movement.angles(frame)
        self._mcap.write(
            RosFrame(
                self._at(frame.time_ns),
                fused.positions,
                self._rotations.update(fused.positions, frame.time_ns),
                np.ones(len(self._setup.body), dtype=bool),
                fused.covariance,
                angles,
                fused.a_from_b if is_placed(self._setup) else None,
                self._movement.floor,
            )
        )
        self._written += 1
        for event in (*self._early, *self._movement.new_events()):
            self.send_event(event)
        self._early.clear()
        if self._clock() >= self._due_ns:
            self._write()
        return 1

    def send_event(self, event: Event) -> None:
        """Adds an event; before the first frame its time since 1970 is not known."""
        if self._written:
            self._mcap.event(self._at(event.time_ns), event)
        else:
            self._early.append(event)

    def send_setup(self, setup: FusionSetup) -> None:
        self._setup = setup

    def send_silence(self, time_ns: int) -> None:
        """Writes what was added: nothing may follow for long."""
        del time_ns
        self._write()

    def shut(self) -> None:
        """Writes the last events, and closes the file."""
        try:
            if self._written and self.failure is None:
                self._write()
        except UsageError as fault:
            self.failure = str(fault)
        try:
            self._file.close()
        except OSError as fault:
            self.failure = self.failure or f"{self._path} could not be written: {fault.strerror}."

    def _at(self, time_ns: int) -> int:
        return max(time_ns + self._begun_ns, 0)

    def _write(self) -> None:
        self._due_ns = self._clock() + _EVERY_NS
        block = self._waiting.taken()
        ending = _Waiting(self._waiting.tell())
        self._mcap.ending(self._waiting, ending)
        try:
            self._file.append(block, ending.taken())
        except OSError as error:
            raise UsageError(
                f"{self._path} is not saved to its end: {error.strerror or error}. Everything before "
                "that can be read."
            ) from error


class _Waiting:
    """What was written to a file of which so many bytes are on the disk."""

    def __init__(self, on_disk: int = 0) -> None:
        self._on_disk, self._bytes = on_disk, bytearray()

    def write(self, block: bytes) -> int:
        self._bytes += block
        return len(block)

    def tell(self) -> int:
        return self._on_disk + len(self._bytes)

    def taken(self) -> bytes:
        """What is not on the disk; it is from now on."""
        taken, self._bytes = bytes(self._bytes), bytearray()
        self._on_disk += len(taken)
        return taken
