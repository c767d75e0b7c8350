"""The commands of the program, and the options that a command line states."""

from __future__ import annotations

import inspect
import io
from collections.abc import Callable
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
from viewer_app.options.usage import mistake

COMMANDS: dict[str, tuple[Callable[..., Any], str]] = {
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


def parsed(arguments: list[str]) -> Any:
    """The options of the command that a command line states; ``--help`` ends the program.

    Raises:
        UsageError: The command line is not accepted.
    """
    import tyro

    with redirect_stderr(io.StringIO()):  # a box of several lines, which is not shown
        try:
            return tyro.cli(
                _command_line(overview=not arguments or arguments[0].startswith("-")),
                args=arguments,
                prog="duplex",
                description="One skeleton from two Kinects. --version prints the program's version.",
                config=(
                    tyro.conf.OmitSubcommandPrefixes,
                    tyro.conf.FlagCreatePairsOff,
                    tyro.conf.DisallowNone,
                ),
            )
        except SystemExit as end:
            if not end.code:
                raise
    raise UsageError(mistake(arguments, {name: kind for name, (kind, _) in COMMANDS.items()}))


def _command_line(overview: bool) -> Any:
    """The command table as a union of subcommands; a group is a nested union.

    Args:
        overview: Whether a command is described by the first paragraph of its help only.
    """
    import tyro

    nothing = Annotated[None, tyro.conf.Suppress]  # cannot be selected; a union needs two members
    commands: Any = nothing
    groups: dict[str, Any] = dict.fromkeys(_GROUPS, nothing)
    for name, (options, _) in COMMANDS.items():
        group, _, command = name.rpartition(" ")
        text = inspect.getdoc(options) or ""
        description = " ".join(text.partition("\n\n")[0].split()) if overview else None
        subcommand = Annotated[
            Any, tyro.conf.subcommand(command, constructor=options, description=description)
        ]
        if group:
            groups[group] |= subcommand
        else:
            commands |= subcommand
    for name, union in groups.items():
        commands |= Annotated[Any, tyro.conf.subcommand(name, constructor=union, description=_GROUPS[name])]
    return commands
