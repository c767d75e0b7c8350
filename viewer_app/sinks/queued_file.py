"""A file that a thread of its own writes: the base of all that may wait for a disk and keeps what it gets."""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Callable
from pathlib import Path
from typing import Generic, TypeVar

from devices.output_file import KeptError
from devices.sensor import DeviceError
from viewer_app.sinks.item_queue import ItemQueue

Item = TypeVar("Item")
_AGAIN_S = 1.0


class QueuedFile(Generic[Item]):
    """Queues frames for a file; only :meth:`close` waits for the disk.

    While `keep_with_images` items wait, because the disk is slow, new frames lose images; while `keep` wait,
    they are lost. A file that cannot be written, as on a full disk, is tried again until the end. It keeps
    the frames before.

    A subclass starts the thread when it is ready, and implements :meth:`_write` and :meth:`_without_images`.

    Args:
        on_failure: Called on the thread with the reason when the writing first waits, or ends early.

    Attributes:
        failure: Why not everything is saved, in a sentence; None if it is.
        waited: Why it waited for the disk, in a sentence; None if it did not.
        written: Frames in the file.
        lost: Frames that came and are not in the file.
        without_images: Frames that lost images.
    """

    keep: int
    keep_with_images: int
    frame_type: type = object  # other items are neither lost nor counted
    thinned = "their images"

    def __init__(self, path: Path, name: str, on_failure: Callable[[str], object] = lambda _: None) -> None:
        self.path = path
        self.failure: str | None = None
        self.waited: str | None = None
        self.written = self.lost = self.without_images = self._came = 0
        self._queue: ItemQueue[Item] = ItemQueue(self._admitted)
        self._on_failure = on_failure
        self._fault: BaseException | None = None
        self._thread = threading.Thread(target=self._run, name=name, daemon=False)

    @property
    def written_bytes(self) -> int:
        """The file's size so far."""
        try:
            return self.path.stat().st_size if self.written else 0
        except OSError:
            return 0

    @property
    def missing(self) -> list[str]:
        """What the file lacks, in sentences; a failure says its reason."""
        if not self._came and self.failure is None:
            return [f"{self.path} was not written: no frame arrived."]
        slow, thinned = "the disk" if self.waited else "this machine", self.without_images
        losses = (
            (self.lost, "not saved" if self.failure else "not saved: the disk was too slow"),
            (0 if self.failure else thinned, f"saved without {self.thinned}: {slow} was too slow"),
        )
        return [
            f"{self.path}: {count} frame{' is' if count == 1 else 's are'} {what}."
            for count, what in losses
            if count
        ]

    def close(self) -> None:
        """Writes what is queued and closes the file. Closing twice has no effect.

        Raises:
            Exception: A fault of the writer that is neither the disk's nor the sensor's.
        """
        self._queue.end()
        self._thread.join()
        fault, self._fault = self._fault, None
        if fault is not None:
            raise fault

    def _write(self) -> None:
        """Writes on the thread what is queued, until the queue is ended and empty."""
        raise NotImplementedError

    def _without_images(self, item: Item) -> Item:
        """The item without the images that a slow disk costs; itself if it has none."""
        raise NotImplementedError

    def _admitted(self, queued: deque[Item], item: Item) -> Item | None:
        if not isinstance(item, self.frame_type):
            return item
        self._came += 1
        if self._queue.ended or len(queued) >= self.keep:
            self.lost += 1
            return None
        if len(queued) >= self.keep_with_images:
            item, whole = self._without_images(item), item
            self.without_images += item is not whole
        return item

    def _again(self, fault: OSError) -> bool:
        """Waits before a block is tried again that could not be written; False at the end."""
        if self.waited is None:
            self.waited = f"{self.path} cannot be written at the moment: {_why(fault)}. Frames wait for it."
            self._on_failure(self.waited)
        return self._queue.has_time(_AGAIN_S)

    def _run(self) -> None:
        try:
            self._write()
        except (OSError, DeviceError) as fault:
            why = _why(fault)
            if isinstance(fault, KeptError) and isinstance(first := fault.__context__, OSError):
                why = f"{_why(first)}; what was written is {fault.kept}"
            self.failure = (
                f"{self.path} is not saved from frame {self.written} on: {why}. Everything before that can "
                f"be read."
                if self.written and not isinstance(fault, KeptError)
                else f"{self.path} could not be written: {why}."
            )
            self._on_failure(self.failure)
        except BaseException as fault:
            self._fault = fault
        finally:
            self._queue.end()
            with self._queue.changed:
                self._queue.take(0.0)
                self.lost = self._came - self.written


def _why(fault: BaseException) -> str:
    return str(getattr(fault, "strerror", None) or fault).removesuffix(".")
