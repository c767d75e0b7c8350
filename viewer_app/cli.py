"""The program ``duplex``: one command a task; a mistake is one line and exit code 2."""

from __future__ import annotations

import importlib
import os
import sys
from collections.abc import Callable, Sequence
from typing import Annotated, Any

import tyro

from viewer_app.options import BenchSpeedOptions, FuseOptions

_COMMANDS: dict[str, tuple[Callable[..., Any], str]] = {
    "fuse": (FuseOptions, "viewer_app.fuse"),
    "bench speed": (BenchSpeedOptions, "viewer_app.bench_speed"),
}
"""By name, ``group command`` or ``command``: the options, and the module whose ``run`` carries it out."""

_GROUPS = {"bench": "Measure the method on this machine."}


def main(arguments: Sequence[str] | None = None) -> None:
    """The console script.

    Args:
        arguments: What follows the program's name; those of the process where None.
    """
    os.environ.setdefault("RERUN_ANALYTICS", "0")
    os.environ.setdefault(
        "OPENBLAS_NUM_THREADS", "1"
    )  # all matrices are small: more threads wait on each other
    options = tyro.cli(
        _command_line(),
        args=arguments,
        prog="duplex",
        description="One skeleton from two Kinects.",
        config=(tyro.conf.OmitSubcommandPrefixes, tyro.conf.FlagCreatePairsOff),
    )
    module = next(module for kind, module in _COMMANDS.values() if kind is type(options))
    try:
        importlib.import_module(module).run(options)
    except KeyboardInterrupt:
        print("duplex: stopped", file=sys.stderr)
        sys.exit(130)
    except Exception as error:
        if not isinstance(error, _mistakes()):
            raise
        print(f"duplex: {error}", file=sys.stderr)
        sys.exit(2)


def _command_line() -> Any:
    """The table as a union of subcommands, a group being a union within it."""
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
    main()
