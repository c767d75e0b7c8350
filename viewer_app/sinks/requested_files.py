"""Session files that begin and end on request, while a run goes on."""

from __future__ import annotations

import threading
from collections.abc import Callable, Collection
from datetime import datetime
from pathlib import Path
from typing import Literal, Protocol

from fusion.setup import FusionSetup
from recordings.appearance.coach_page import CoachPage
from recordings.data.session_arrays import SessionFrame
from viewer_app.errors import UsageError
from viewer_app.output_files import check_writable
from viewer_app.sinks.session_file import SessionFile
from viewer_app.sinks.sink import FanOut

Saving = Literal["ready", "saving", "ending", "saved", "failed"]


class Requests(Protocol):
    """Who asks for a file, and is told what becomes of it."""

    def take_request(self) -> bool | None:
        """Whether to save, as it was asked for since the last call; None if it was not."""

    def tell_saving(self, state: Saving, text: str) -> None:
        """Takes the state, with a file's name or the reason of a failure; from any thread."""


class RequestedFiles(FanOut):
    """Writes each frame between a request and the next to a session file of its own.

    Args:
        setup: That of the first frame.
        opened: Opens a file of this name, whose first frame has this setup.
    """

    def __init__(
        self, setup: FusionSetup, requests: Requests, opened: Callable[[Path, FusionSetup], SessionFile]
    ) -> None:
        super().__init__(())
        self.file: SessionFile | None = None
        """The one that gets the frames now."""
        self._setup, self._requests, self._opened = setup, requests, opened
        self._page: CoachPage | None = None
        self._ending: list[threading.Thread] = []
        self._faults: list[BaseException] = []
        self._waited: str | None = None  # as it was told
        self.files: list[SessionFile] = []
        """All of them, in order."""
        requests.tell_saving("ready", "")

    def write(self, frame: SessionFrame) -> None:
        """Begins or ends a file if that was asked for; writes the frame to the file that is open."""
        wanted, file = self._requests.take_request(), self.file
        if file is not None and (wanted is False or file.failure is not None):
            self._end(file)
        elif file is None and wanted:
            path = free_path(Path(), datetime.now(), [each.path for each in self.files])
            try:
                check_writable(path.absolute(), force=False)
            except (UsageError, OSError) as refusal:  # the folder is read-only, or gone
                self._requests.tell_saving("failed", str(refusal))
            else:
                self._begin(path)
        elif file is not None and file.waited not in (None, self._waited):  # for the disk
            self._waited = file.waited
            self._requests.tell_saving("saving", file.waited)
        super().write(frame)

    def _begin(self, path: Path) -> None:
        file = self._opened(path, self._setup)
        if self._page is not None:
            file.coach(self._page)
        self.files.append(file)
        self.file, self.sinks = file, (file,)
        self._requests.tell_saving("saving", file.path.name)

    def recalibrated(self, setup: FusionSetup) -> None:
        self._setup = setup
        super().recalibrated(setup)

    def coach(self, page: CoachPage) -> None:
        self._page = page
        super().coach(page)

    def close(self) -> None:
        """Ends the open file, and waits for all that end.

        Raises:
            Exception: As :meth:`SessionFile.close`, the first one.
        """
        if self.file is not None:
            self._end(self.file)
        for thread in self._ending:
            thread.join()
        faults, self._faults = self._faults, []
        if faults:
            raise faults[0]

    def _end(self, file: SessionFile) -> None:
        """Ends a file on a thread: it may wait for the disk."""
        self.file, self.sinks = None, ()
        file.finish()

        def end() -> None:
            why = None
            try:
                file.close()
            except BaseException as fault:  # of the writer; close raises it on the loop's thread
                self._faults.append(fault)
                why = f"{file.path.name} could not be written: {fault!r}."
            why = why or file.failure
            self._requests.tell_saving("failed" if why else "saved", why or file.path.name)

        self._requests.tell_saving("ending", file.path.name)
        thread = threading.Thread(target=end, name="end of a session file")
        self._ending.append(thread)
        thread.start()


def free_path(folder: Path, now: datetime, taken: Collection[Path] = ()) -> Path:
    """A name by the time that no file in the folder has, nor one that is to come there."""
    stem, number = f"duplex-{now:%Y%m%d-%H%M%S}", 1
    path = folder / f"{stem}.rrd"
    while path.exists() or path in taken:
        number += 1
        path = folder / f"{stem}-{number}.rrd"
    return path
