"""A file in a viewer's window: written first, then shown, so that no viewer can hold up the writing."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from uuid import uuid4

import rerun as rr
import rerun.blueprint as rrb

from recordings import layout
from recordings.writing.rewritten_session import check_whole
from viewer_app.output_files import whole_file
from viewer_app.viewer.rerun_process import start_viewer

_FLUSH_WITHIN = 30.0  # seconds


@contextmanager
def written_and_shown(
    save: Path | None, window: bool, blueprint: rrb.Blueprint, application: str = layout.APPLICATION_ID
) -> Iterator[rr.RecordingStream]:
    """A recording stream into a file, which a new window shows when the block has ended well.

    The file appears under its name only then; without a name it exists for the window only. The window stays
    when this process ends.

    Args:
        save: The file; None for none.
        window: Whether to show it.
        blueprint: What the viewer shows.
        application: A viewer remembers a layout for each.

    Raises:
        UsageError: The viewer does not start, or the file cannot be written.
    """
    with ExitStack() as stack:
        path = None
        if save is not None:
            path = stack.enter_context(whole_file(save))
        elif window:
            path = Path(stack.enter_context(tempfile.TemporaryDirectory())) / "session.rrd"
        stream = rr.RecordingStream(application, recording_id=uuid4())
        if path is not None:
            stream.set_sinks(rr.FileSink(str(path)))
        try:
            yield stream
            # the timeline it names must be there; active, or the viewer would show what it remembers
            stream.send_blueprint(blueprint)
            stream.flush(timeout_sec=_FLUSH_WITHIN)
        finally:
            stream.disconnect()
        if path is not None:
            check_whole(path)
            if window:
                show(path)


def show(path: Path) -> None:
    """Opens a session in a new window; the file may go as soon as this returns.

    Raises:
        UsageError: The viewer does not start.
    """
    with path.open("rb") as file:
        start_viewer(["--hide-welcome-screen", "-"], file)
