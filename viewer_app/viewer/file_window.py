"""Shows a file in a viewer window after writing it, so that no viewer can block the writing."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

from viewer_app.output_files import whole_file
from viewer_app.viewer.rerun_process import start_viewer
from viewer_app.viewer.stored_clouds import add_clouds, has_depth_images


@contextmanager
def written_and_shown(save: Path | None, window: bool) -> Iterator[Path | None]:
    """Yields a path to write to; a new window shows the file after the block ends without error.

    The file gets its final name only then; without a name it exists only for the window. The window stays
    open when this process ends.

    Args:
        save: The file; None for none.
        window: Whether to show it.

    Yields:
        A temporary path; None where there is nothing to write.

    Raises:
        UsageError: The viewer does not start, or the file cannot be written.
    """
    with ExitStack() as stack:
        path = None
        if save is not None:
            path = stack.enter_context(whole_file(save))
        elif window:
            path = Path(stack.enter_context(tempfile.TemporaryDirectory())) / "session.rrd"
        yield path
        if path is not None and window:
            show(path)


def show(path: Path) -> None:
    """Opens a session in a new window; the file may be deleted as soon as this returns.

    Raises:
        UsageError: The viewer does not start.
    """
    with path.open("rb") as file:
        started = start_viewer(["--hide-welcome-screen", "-"], file)
        if has_depth_images(path):
            add_clouds(file, started[1])
