"""The pytest plugin, which pip registers: a simulated session, ``--duplex-update``, and sessions kept when a
test fails. Every run of pytest imports it, so it imports no more than pytest and :mod:`recordings.testing`.
"""

from __future__ import annotations

import inspect
import os
import re
import shlex
import tempfile
from collections.abc import Callable, Sequence
from contextlib import nullcontext
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

from recordings import testing

if TYPE_CHECKING:
    from recordings.session import Session

_NAMES = ("actual", "expected")
_WRITTEN = "duplex_written"
"""The user property of a report that names an expected file."""


def pytest_addoption(parser: pytest.Parser) -> None:
    """Adds ``--duplex-update``."""
    parser.getgroup("duplex-kinects").addoption(
        "--duplex-update",
        action="store_true",
        help="Write the expected sessions of assert_sessions_match, where they are files.",
    )


def pytest_configure(config: pytest.Config) -> None:
    """Tells :func:`recordings.testing.assert_sessions_match` whether to write, and where progress goes."""
    testing.update_expected = config.getoption("duplex_update")

    def tell(progress: object) -> None:
        terminal, capture = map(config.pluginmanager.getplugin, ("terminalreporter", "capturemanager"))
        if terminal is not None:
            with nullcontext() if capture is None else capture.global_and_fixture_disabled():
                terminal.write_line(str(progress))

    testing.tell_first_run = tell


def pytest_unconfigure() -> None:
    """Ends what :func:`pytest_configure` began."""
    testing.update_expected, testing.tell_first_run = False, None


@pytest.fixture(scope="session")
def simulated_session() -> Callable[..., Session]:
    """Factory of sessions of two simulated sensors: simulated_session("walk", seconds=4.0, seed=0).

    The arguments are those of recordings.testing.simulated_session; equal ones give the same object.
    """
    made, signature = cache(testing.simulated_session), inspect.signature(testing.simulated_session)

    def factory(*args: Any, **arguments: Any) -> Session:
        given = signature.bind(*args, **arguments)
        given.apply_defaults()
        return made(*given.args, **given.kwargs)

    return factory


@pytest.hookimpl(tryfirst=True)
def pytest_runtest_makereport(item: pytest.Item, call: pytest.CallInfo[None]) -> None:
    """Keeps the sessions of a failed test with a picture, and says where."""
    item.user_properties += [(_WRITTEN, str(path)) for path in testing.written]
    testing.written.clear()
    if call.excinfo is not None and isinstance(error := call.excinfo.value, testing.SessionsDifferError):
        begun = item.config.invocation_params.dir
        test = "::".join([_seen_from(begun, item.path), *item.nodeid.split("::")[1:]])
        update = shlex.join(["pytest", "--duplex-update", test])
        error.add_note("")
        if error.to_make:
            error.add_note(f"to make it, with a version that you trust: {update}")
            return
        try:
            kept = _kept(item, error.sessions)
        except OSError as why:
            error.add_note(f"The sessions could not be kept: {why}.")
            return
        for name, path in kept.items():
            error.add_note(f"{name + ':':9} {_seen_from(begun, path)}")
        for name, session in zip(_NAMES, error.sessions, strict=False):
            error.add_note(f"{name} is {session}")
        sessions = [_seen_from(begun, kept[name]) for name in _NAMES if name in kept]
        for command in _commands(error.sessions, sessions):
            error.add_note(f"to see it:    {shlex.join(command)}")
        if len(sessions) > 1 and error.sessions[1].path is not None:
            error.add_note(f"to accept it: {update}")


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter) -> None:
    """Names the expected files that were written."""
    reports = (each for every in terminalreporter.stats.values() for each in every)
    properties = (found for report in reports for found in getattr(report, "user_properties", ()))
    for path in sorted({path for name, path in properties if name == _WRITTEN}):
        shown = _seen_from(terminalreporter.config.invocation_params.dir, Path(path))
        terminalreporter.write_line(f"Wrote {shown}.")


def _kept(item: pytest.Item, sessions: Sequence[Session]) -> dict[str, Path]:
    """The files of the sessions, without images, and a picture of two."""
    from recordings.comparing.session_differences import write_worst_moment
    from recordings.data.images import NO_IMAGES

    cached = getattr(item.config, "cache", None)
    root = Path(tempfile.mkdtemp(prefix="duplex-")) if cached is None else cached.mkdir("duplex")
    folder = root / re.sub(r"[^\w.-]+", "_", item.nodeid)[-100:]
    folder.mkdir(exist_ok=True)
    kept: dict[str, Path] = {}
    for name, session in zip(_NAMES, sessions, strict=False):
        kept[name] = folder / f"{name}.rrd"
        replace(session, images=NO_IMAGES).save(kept[name])
    picture = folder / "worst.png"
    if len(sessions) > 1 and write_worst_moment(sessions[0], sessions[1], picture):
        kept["picture"] = picture
    return kept


def _commands(sessions: Sequence[Session], paths: Sequence[str]) -> list[list[str]]:
    """The command that shows what differs; sessions of different bodies are shown one by one."""
    from recordings.comparing.session_comparison import Comparison
    from recordings.errors import RecordingError

    if len(sessions) == 1 or sessions[0].body is not sessions[1].body:
        return [["duplex", "review", path] for path in paths]
    try:
        Comparison.of(sessions[0], sessions[1])
    except RecordingError:
        return [["duplex", "compare", "--any-capture", *paths]]
    return [["duplex", "compare", *paths]]


def _seen_from(folder: Path, path: Path) -> str:
    """A path as one types it in a folder."""
    return os.path.relpath(path, folder) if path.absolute().is_relative_to(folder) else str(path)
