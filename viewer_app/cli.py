"""The program ``duplex``: one command per task. A usage error prints one line and exits with code 2."""

from __future__ import annotations

import importlib
import io
import os
import signal
import sys
from collections.abc import Callable, Sequence
from contextlib import redirect_stderr
from typing import Annotated, Any

from viewer_app.errors import UsageError
from viewer_app.options.batch import BatchOptions
from viewer_app.options.bench import (
    BenchAccuracyOptions,
    BenchOutputsOptions,
    BenchRealOptions,
    BenchSpeedOptions,
)
from viewer_app.options.sensing import (
    DemoOptions,
    DoctorOptions,
    FuseOptions,
    LiveOptions,
    PublishOptions,
)
from viewer_app.options.sessions import (
    CompareOptions,
    ExportOptions,
    InfoOptions,
    ReplayOptions,
    ReviewOptions,
    TrimOptions,
)
from viewer_app.options.tracker import TrackerFetchOptions
from viewer_app.usage import mistake

_COMMANDS: dict[str, tuple[Callable[..., Any], str]] = {
    "demo": (DemoOptions, "viewer_app.commands.demo"),
    "live": (LiveOptions, "viewer_app.commands.live"),
    "sensor": (PublishOptions, "viewer_app.commands.sensor"),
    "fuse": (FuseOptions, "viewer_app.commands.fuse"),
    "batch": (BatchOptions, "viewer_app.batch.command"),
    "replay": (ReplayOptions, "viewer_app.commands.replay"),
    "review": (ReviewOptions, "viewer_app.commands.review"),
    "compare": (CompareOptions, "viewer_app.commands.compare"),
    "export": (ExportOptions, "viewer_app.commands.export"),
    "trim": (TrimOptions, "viewer_app.commands.trim"),
    "info": (InfoOptions, "viewer_app.commands.info"),
    "doctor": (DoctorOptions, "viewer_app.commands.doctor"),
    "tracker fetch": (TrackerFetchOptions, "viewer_app.commands.tracker"),
    "bench accuracy": (BenchAccuracyOptions, "viewer_app.bench.accuracy"),
    "bench real": (BenchRealOptions, "viewer_app.bench.real"),
    "bench speed": (BenchSpeedOptions, "viewer_app.bench.speed"),
    "bench outputs": (BenchOutputsOptions, "viewer_app.bench.outputs"),
}
"""Options and module of each command, by ``command`` or ``group command``; the module has a ``run``."""

_GROUPS = {
    "bench": "Measure the method on this machine.",
    "tracker": "The program's own body tracker, BlazePose.",
}


def script() -> None:
    """The console script: runs :func:`main`, then ignores Ctrl-C during shutdown."""
    try:
        main()
    except KeyboardInterrupt:
        sys.exit(130)
    finally:
        signal.signal(signal.SIGINT, signal.SIG_IGN)  # during shutdown it would print a traceback


def main(arguments: Sequence[str] | None = None) -> None:
    """Runs a command line.

    Args:
        arguments: The arguments after the program's name. None: the arguments of the process.
    """
    os.environ.setdefault("RERUN_ANALYTICS", "0")
    # all matrices are small: more threads would only wait for each other
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="replace")  # a terminal without a character shows a replacement
    try:
        _run(arguments)
        sys.stdout.flush()
    except KeyboardInterrupt:
        print("duplex: stopped", file=sys.stderr)
        sys.exit(130)
    except BrokenPipeError:
        # the reader of the output is gone: write nothing more, not even at exit
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        sys.exit(1)
    except Exception as error:
        if not isinstance(error, _mistakes()):
            raise
        print(f"duplex: {error}", file=sys.stderr)
        sys.exit(2)


def _run(arguments: Sequence[str] | None) -> None:
    given = list(sys.argv[1:] if arguments is None else arguments)
    if given == ["--version"]:
        from importlib.metadata import version

        print(f"duplex {version('duplex-kinects')}")
        return
    options = _parsed(given)
    module = next(module for kind, module in _COMMANDS.values() if kind is type(options))
    importlib.import_module(module).run(options)


def _parsed(arguments: list[str]) -> Any:
    """The options of the command; a mistake raises UsageError, --help ends the program."""
    import tyro

    with redirect_stderr(io.StringIO()):  # a box of several lines, which is not shown
        try:
            return tyro.cli(
                _command_line(),
                args=arguments,
                prog="duplex",
                description="One skeleton from two Kinects. --version prints the program's version.",
                config=(tyro.conf.OmitSubcommandPrefixes, tyro.conf.FlagCreatePairsOff),
            )
        except SystemExit as end:
            if not end.code:
                raise
    raise UsageError(mistake(arguments, {name: kind for name, (kind, _) in _COMMANDS.items()}))


def _command_line() -> Any:
    """The command table as a union of subcommands; a group is a nested union."""
    import tyro

    nothing = Annotated[None, tyro.conf.Suppress]  # cannot be selected; a union needs two members
    commands: Any = nothing
    groups: dict[str, Any] = dict.fromkeys(_GROUPS, nothing)
    for name, (options, _) in _COMMANDS.items():
        group, _, command = name.rpartition(" ")
        subcommand = Annotated[Any, tyro.conf.subcommand(command, constructor=options)]
        if group:
            groups[group] |= subcommand
        else:
            commands |= subcommand
    for name, union in groups.items():
        commands |= Annotated[Any, tyro.conf.subcommand(name, constructor=union, description=_GROUPS[name])]
    return commands


def _mistakes() -> tuple[type[Exception], ...]:
    from devices.sensor import DeviceError
    from fusion.errors import FusionError
    from recordings.errors import RecordingError

    return (DeviceError, FusionError, RecordingError, UsageError)


if __name__ == "__main__":
    script()
