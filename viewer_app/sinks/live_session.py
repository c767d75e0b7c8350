"""The sinks of a running loop: viewer, file, further sinks. The loop waits for none of them."""

from collections.abc import Callable, Mapping, Sequence
from contextlib import AbstractContextManager
from pathlib import Path
from uuid import uuid4

import rerun as rr
import rerun.blueprint as rrb

from devices.events import Event
from fusion.setup import FusionSetup
from recordings.data import layout
from recordings.writing.recorder import Recorder
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
        overwrite: bool = False,
        viewing: Viewing | None = None,
        others: Sequence[Sink] = (),
        file_blueprint: rrb.Blueprint | None = None,
        reframed: Callable[[FusionSetup], rrb.Blueprint] | None = None,
        about: Mapping[str, str | int] | None = None,
        sample: bool = False,
    ) -> None:
        identity = uuid4()
        self.viewer: ViewerSink | None = None
        if viewing is not None and viewing.hub is not None:
            shown = SAMPLE if sample else None
            self.viewer = ViewerSink(
                setup, sources, blueprint, viewing, identity, file is None, reframed, shown
            )
        self.file: SessionFile | None = None
        viewer = self.viewer

        def begin(stream: rr.RecordingStream) -> Recorder:
            pause = None if viewer is None else lambda: viewer.wait_until_free(_PAUSE)
            recorder = Recorder(stream, setup, sources, depth_every=1, about=about, pause=pause)
            # The blueprint's timeline must exist. If not active, a viewer restores a remembered layout.
            stream.send_blueprint(file_blueprint or blueprint)
            return recorder

        if file is not None:
            self.file = SessionFile(
                file,
                lambda: rr.RecordingStream(layout.APPLICATION_ID, recording_id=identity),
                begin,
                overwrite=overwrite,
                turn=None if viewer is None else viewer.wait_for_turn,
                on_failure=lambda why: None if viewer is None else viewer.event(Event(why, "ERROR")),
            )
        super().__init__([sink for sink in (self.file, self.viewer, *others) if sink is not None])

    def begin(self) -> None:
        """Shows this session where the viewer showed a sample."""
        if self.viewer is not None:
            self.viewer.begin()

    def save(self) -> None:
        """Writes the queued items to the file and closes it; later items go only to the other sinks."""
        if self.file is not None:
            self.file.close()

    def __exit__(self, *exc_info: object) -> None:
        self.close()
