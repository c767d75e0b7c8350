"""The commands of the program, and the options that a command line states."""

import inspect
from collections.abc import Callable
from typing import Any

from cyclopts import (
    App,
    Argument,
    CoercionError,
    CycloptsError,
    Group,
    MissingArgumentError,
    Parameter,
    RepeatArgumentError,
    Token,
    UnusedCliTokensError,
)

from viewer_app.errors import UsageError, refuse_bytes
from viewer_app.options.needs import refuse_without_effect
from viewer_app.options.sensing import (
    BatchOptions,
    DemoOptions,
    DoctorOptions,
    FuseOptions,
    LiveOptions,
    PublishOptions,
    RecordOptions,
    TrackerFetchOptions,
)
from viewer_app.options.sessions import (
    CompareOptions,
    ExportOptions,
    InfoOptions,
    ReplayOptions,
    ReviewOptions,
    TrimOptions,
)

COMMANDS: dict[str, tuple[Callable[..., Any], str]] = {
    "demo": (DemoOptions, "viewer_app.commands.demo"),
    "live": (LiveOptions, "viewer_app.commands.live"),
    "record": (RecordOptions, "viewer_app.commands.record"),
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
}
"""Options and module of each command, by ``command`` or ``group command``. The module has a ``run``;
its errors (:class:`fusion.errors.DuplexError`) have one line for the person who asked."""

_GROUPS = {"tracker": "The program's own body tracker, BlazePose."}
_LONGEST = 200  # characters of a message; longer ones, with a long value, lose their middle
_NUMBERS = {int: "a whole number", float: "a number"}


def parsed(arguments: list[str]) -> Any:
    """The options of the command that a command line states; ``--help`` ends the program."""
    for argument in arguments:
        refuse_bytes(argument)
    given = " ".join(arguments)
    if given in ("", *_GROUPS):
        commands = [name.removeprefix(f"{given} ") for name in COMMANDS if name.startswith(given)]
        program = f"duplex {given}".rstrip()
        raise UsageError(f"name a command: {', '.join(commands)} ({program} --help)")
    try:
        options = _program()(arguments, print_error=False, exit_on_error=False, result_action="return_value")
    except CycloptsError as error:
        error.verbose = False
        reason = " ".join(_reason(error).split())
        if len(reason) > _LONGEST:
            reason = f"{reason[: _LONGEST // 2]} … {reason[-_LONGEST // 2 :]}"
        raise UsageError(f"{reason} ({' '.join(['duplex', *(error.command_chain or ())])} --help)") from None
    if options is None:  # the help was asked for
        raise SystemExit(0)
    refuse_without_effect(options)
    return options


def _reason(error: CycloptsError) -> str:
    """What is wrong with a command line, in the parser's words but for the most frequent mistakes."""
    match error:
        case MissingArgumentError(keyword=str() as name):
            return f"{name} needs a value"
        case MissingArgumentError(argument=Argument() as missing):
            is_option = not missing.field_info.is_positional
            return (
                f"missing option {missing.name}"
                if is_option
                else f"missing argument {missing.name[2:].upper()}"
            )
        case RepeatArgumentError(token=Token(keyword=str() as name)):
            return f"{name} is given twice"
        case UnusedCliTokensError(unused_tokens=[token, *_]):
            return f"one argument too many: {token!r}"
        case CoercionError(token=Token(keyword=str() as name, value=value), target_type=kind):
            if kind in _NUMBERS:
                return f"{name} must be {_NUMBERS[kind]}; got {value!r}"
    return str(error)


def _program() -> App:
    """The command table as a parser: a command is the class of its options."""
    program = App(
        "duplex",
        help="One skeleton from two Kinects. --version prints the program's version.",
        help_format="markdown",
        version_flags=(),
        usage="",
        default_parameter=Parameter(negative=(), consume_multiple=True, show_default=_worth_showing),
        group_parameters=Group("Options", sort_key=0),
    )
    apps = {"": program}
    for place, (name, (options, _)) in enumerate(COMMANDS.items()):
        group, _, command = name.rpartition(" ")
        if group not in apps:
            apps[group] = App(group, help=_GROUPS[group], sort_key=place)
            program.command(apps[group])
        apps[group].command(options, name=command, help=inspect.getdoc(options), sort_key=place)
    return program


def _worth_showing(default: object) -> str | None:
    """A default as the help shows it; None where it says nothing, as that of a switch."""
    return None if default is None or default is False or default in ((), "") else str(default)
