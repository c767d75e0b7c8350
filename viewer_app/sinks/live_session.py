"""The sinks of a running loop: viewer, file, further sinks. The loop waits for none of them."""

from collections.abc import Callable, Mapping, Sequence
from contextlib import AbstractContextManager
from pathlib import Path
from uuid import UUID, uuid4

import rerun as rr
import rerun.blueprint as rrb

from devices.events import Event
from fusion.setup import FusionSetup
from recordings.data import layout
from recordings.writing.recorder import Recorder
from viewer_app.sinks.requested_files import RequestedFiles, Requests
from viewer_app.sinks.session_file import SessionFile
from viewer_app.sinks.sink import FanOut, Sink
from viewer_app.sinks.viewer_sink import ViewerSink
from viewer_app.viewer.viewer_choice import Viewing

SAMPLE = Path(__file__).parents[1] / "viewer" / "recorded_sample.rrd"
"""A few seconds of two sensors; ``python -m tests.experiments.recorded_sample`` makes it."""
_PAUSE = 0.02
"""Longest time in seconds that the file's thread waits between two messages while the viewer's is writing."""


class LiveSession(FanOut, AbstractContextManager["LiveSession"]):
    """A viewer and a file of one recording, and further sinks.

    File and viewer each have a thread and a recording stream of the same recording id. Use it as a context
    manager.

    Args:
        file: The file to write; None for none. It is readable while it grows.
        requests: Who may ask for further files, in the working folder; None for nobody.
        file_blueprint: The layout in the file; None: the viewer's. A file lacks what only a viewer is shown.
        reframed: Makes the viewer's layout of a setup in which B stands elsewhere; None: it stays.
        sample: Whether the viewer shows a recorded sample until :meth:`begin`.
    """

    def __init__(
        self,
        setup: FusionSetup,
        sources: tuple[str, str],
        blueprint: rrb.Blueprint,
        *,
        file: Path | None = None,
        requests: Requests | None = None,
        overwrite: bool = False,
        viewing: Viewing | None = None,
        others: Sequence[Sink] = (),
        file_blueprint: rrb.Blueprint | None = None,
        reframed: Callable[[FusionSetup], rrb.Blueprint] | None = None,
        about: Callable[[], Mapping[str, str | int]] = dict,
        sample: bool = False,
    ) -> None:
        identity = uuid4()
        self.viewer: ViewerSink | None = None
        if viewing is not None and viewing.hub is not None:
            shown = SAMPLE if sample else None
            self.viewer = ViewerSink(
                setup, sources, blueprint, viewing, identity, file is None, reframed, shown
            )
        viewer = self.viewer

        def opened(path: Path, setup: FusionSetup, identity: UUID, overwrite: bool = False) -> SessionFile:
            known = about()

            def begin(stream: rr.RecordingStream) -> Recorder:
                pause = None if viewer is None else lambda: viewer.wait_until_free(_PAUSE)
                recorder = Recorder(stream, setup, sources, depth_every=1, about=known, pause=pause)
                # The blueprint's timeline must exist. If not active, a viewer restores a remembered layout.
                stream.send_blueprint(file_blueprint or blueprint)
                return recorder

            return SessionFile(
                path,
                lambda: rr.RecordingStream(layout.APPLICATION_ID, recording_id=identity),
                begin,
                overwrite=overwrite,
                turn=None if viewer is None else viewer.wait_for_turn,
                on_failure=lambda why: None if viewer is None else viewer.event(Event(why, "ERROR")),
            )

        self.file = None if file is None else opened(file, setup, identity, overwrite)
        self.requested: RequestedFiles | None = None
        if requests is not None:
            self.requested = RequestedFiles(setup, requests, lambda path, now: opened(path, now, uuid4()))
        sinks = self.file, self.viewer, self.requested, *others
        super().__init__([sink for sink in sinks if sink is not None])

    @property
    def files(self) -> list[SessionFile]:
        """The session files, in order."""
        asked_for = [] if self.requested is None else self.requested.files
        return asked_for if self.file is None else [self.file, *asked_for]

    @property
    def open_file(self) -> SessionFile | None:
        """The session file that gets the frames now."""
        return self.requested.file if self.requested is not None and self.file is None else self.file

    def begin(self) -> None:
        """Shows this session where the viewer showed a sample."""
        if self.viewer is not None:
            self.viewer.begin()

    def save(self) -> None:
        """Writes the queued items to the files and closes them; later items go only to the other sinks."""
        for file in (self.file, self.requested):
            if file is not None:
                file.close()

    def __exit__(self, *exc_info: object) -> None:
        self.close()
