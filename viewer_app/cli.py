"""The program ``duplex``: one command a task; a mistake is one line and exit code 2."""

from __future__ import annotations

import importlib
import io
import os
import signal
import sys
from collections.abc import Callable, Sequence
from typing import Annotated, Any

from viewer_app.options import (
    BenchAccuracyOptions,
    BenchRealOptions,
    BenchSpeedOptions,
    CompareOptions,
    DemoOptions,
    DoctorOptions,
    ExportOptions,
    FuseOptions,
    InfoOptions,
    LiveOptions,
    ReplayOptions,
    ReviewOptions,
    TrimOptions,
)

_COMMANDS: dict[str, tuple[Callable[..., Any], str]] = {
    "demo": (DemoOptions, "viewer_app.commands.demo"),
    "live": (LiveOptions, "viewer_app.commands.live"),
    "fuse": (FuseOptions, "viewer_app.commands.fuse"),
    "replay": (ReplayOptions, "viewer_app.commands.replay"),
    "review": (ReviewOptions, "viewer_app.commands.review"),
    "compare": (CompareOptions, "viewer_app.commands.compare"),
    "export": (ExportOptions, "viewer_app.commands.export"),
    "trim": (TrimOptions, "viewer_app.commands.trim"),
    "info": (InfoOptions, "viewer_app.commands.info"),
    "doctor": (DoctorOptions, "viewer_app.commands.doctor"),
    "bench accuracy": (BenchAccuracyOptions, "viewer_app.bench.accuracy"),
    "bench real": (BenchRealOptions, "viewer_app.bench.real"),
    "bench speed": (BenchSpeedOptions, "viewer_app.bench.speed"),
}
"""By name, ``group command`` or ``command``: the options, and the module whose ``run`` carries it out."""

_GROUPS = {"bench": "Measure the method on this machine."}


def script() -> None:
    """The console script: :func:`main`, whose end no further Ctrl-C disturbs."""
    try:
        main()
    except KeyboardInterrupt:
        sys.exit(130)
    finally:
        signal.signal(signal.SIGINT, signal.SIG_IGN)  # while Python shuts down it would be a traceback


def main(arguments: Sequence[str] | None = None) -> None:
    """Carries out a command line.

    Args:
        arguments: What follows the program's name; those of the process where None.
    """
    os.environ.setdefault("RERUN_ANALYTICS", "0")
    # all matrices are small: more threads wait on each other
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="replace")  # a terminal that lacks a sign shows another
    try:
        _run(arguments)
        sys.stdout.flush()
    except KeyboardInterrupt:
        print("duplex: stopped", file=sys.stderr)
        sys.exit(130)
    except BrokenPipeError:
        # whoever read the output has gone: nothing is left to say, not even at exit
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        sys.exit(1)
    except Exception as error:
        if not isinstance(error, _mistakes()):
            raise
        print(f"duplex: {error}", file=sys.stderr)
        sys.exit(2)


def _run(arguments: Sequence[str] | None) -> None:
    import tyro

    options = tyro.cli(
        _command_line(),
        args=arguments,
        prog="duplex",
        description="One skeleton from two Kinects.",
        config=(tyro.conf.OmitSubcommandPrefixes, tyro.conf.FlagCreatePairsOff),
    )
    module = next(module for kind, module in _COMMANDS.values() if kind is type(options))
    importlib.import_module(module).run(options)


def _command_line() -> Any:
    """The table as a union of subcommands, a group being a union within it."""
    import tyro

    nothing = Annotated[None, tyro.conf.Suppress]  # no one can choose it; a union needs two
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
    from viewer_app.errors import UsageError

    return (DeviceError, FusionError, RecordingError, UsageError)


if __name__ == "__main__":
    script()
