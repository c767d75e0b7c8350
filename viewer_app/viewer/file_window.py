"""Shows a file in a viewer window after writing it, so that no viewer can block the writing."""

import tempfile
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import TypeVar

from devices.output_file import whole_file
from fusion.support.progress import Progress, quietly
from recordings.appearance.coach_page import CoachPage
from recordings.data import layout
from recordings.file.session_writer import write_session
from recordings.session import Session
from viewer_app.viewer.blueprint import Layout, session_blueprint
from viewer_app.viewer.hub import Hub
from viewer_app.viewer.rerun_process import stop
from viewer_app.viewer.stored_clouds import add_computed, has_depth
from viewer_app.viewer.window import pause, start_viewer, viewer_url

T = TypeVar("T")
_READS_WITHIN = 20.0  # seconds


def write_for_viewer(
    session: Session,
    path: Path,
    page: CoachPage,
    *,
    active: Layout = "inspect",
    progress: Progress = quietly,
) -> int:
    """Writes a session with its page and the layouts; returns how many damaged images it skipped."""
    drawn = session_blueprint(session.last_setup, session.whereabouts, active, depth=has_depth(session))
    return write_session(session, path, blueprint=drawn, page=page, progress=progress)


@contextmanager
def written_and_shown(
    save: Path | None,
    write: Callable[[Path], T],
    *,
    force: bool,
    window: bool,
    served: bool = False,
    at_ns: int = 0,
) -> Iterator[tuple[Path | None, T | None]]:
    """Writes a session, and shows it in a new window after the block, which says and writes all the rest.

    So nothing is lost where no window opens. Without a name, the file exists for the viewer only. The window
    stays open when this process ends.

    Args:
        save: The file's name; None: it has none, and is written only for a window or a server.
        write: Writes it. The file gets its name when it is whole.
        force: Whether to replace an older file.
        served: Whether the block serves the file to browsers.
        at_ns: Where the window opens, ns since the first pair.

    Yields:
        The file and what `write` returned; None if nothing is written.
    """
    if save is None and not (window or served):
        yield None, None
        return
    with ExitStack() as stack:
        file = save or Path(stack.enter_context(tempfile.TemporaryDirectory())) / "session.rrd"
        with whole_file(file, overwrite=force) as hidden:
            written = write(hidden)
        yield file, written
        if window:
            show(file, at_ns)


@contextmanager
def in_this_layout(
    session: Session, path: Path, page: CoachPage, active: Layout | None = None
) -> Iterator[Path]:
    """Yields a file of a session that the layouts of this version can show, with one of them in front.

    A session of an older version lacks what draws S* as a body, the floor and the names of the sensors. It is
    written again for the viewer, with the same frames, events and images; the session itself is not changed.
    So is one that is to open with another layout than it was written for.
    """
    if active is None and session.about["session"]["layout_version"][0] >= layout.VERSION:
        yield path
        return
    with tempfile.TemporaryDirectory() as folder:
        shown = Path(folder) / path.name
        write_for_viewer(session, shown, page, active=active or "inspect")
        yield shown


def show(path: Path, at_ns: int = 0) -> bool:
    """Opens a session in a new window; the file may be deleted as soon as this returns.

    Args:
        at_ns: Where to put the time cursor, ns since the first pair. The viewer would put it at the end.

    Returns:
        Whether it stands there.
    """
    with path.open("rb") as file:
        process, port = start_viewer(["--hide-welcome-screen", "-"], file)
        add_computed(file, viewer_url(port))
    return pause(process, port, at_ns, _READS_WITHIN)


@contextmanager
def served(path: Path, hub: Hub) -> Iterator[None]:
    """Serves a session to browsers during the block."""
    with path.open("rb") as file, ExitStack() as programs:
        programs.callback(stop, hub.serve(file))
        programs.callback(stop, add_computed(file, hub.url))
        yield
