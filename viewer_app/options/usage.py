"""Explains in one line why a command line is not accepted.

tyro decides what is accepted; its own explanation is a box of several lines. This module looks for the
mistake in the same table of commands. It names the first one, from left to right.
"""

from __future__ import annotations

import types
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import MISSING, dataclass, fields
from difflib import get_close_matches
from pathlib import Path
from typing import Annotated, Any, Literal, Union, get_args, get_origin, get_type_hints

_ALIKE = 0.6
_LONGEST = 60  # characters of a value that are repeated in a message


def mistake(arguments: Sequence[str], commands: Mapping[str, Callable[..., Any]]) -> str:
    """One line: what is wrong with a command line that tyro refused, and where the help is.

    Args:
        arguments: The arguments after the program's name.
        commands: The class of options of each command, by ``command`` or ``group command``.
    """
    words, rest = _command(arguments, commands)
    program = " ".join(["duplex", *words])
    what = _of_command(words, rest, commands) or _of_options(rest, _options(commands[" ".join(words)]))
    return f"{what} ({program} --help)"


@dataclass(frozen=True)
class _Option:
    """An option or a positional argument of a command.

    Attributes:
        name: As it is typed, ``--save``; of a positional argument, as the help names it.
        kind: Type of one value.
        values: How many values it takes; None: any number.
        required: Whether it must be given.
        positional: Whether it has no name on the command line.
    """

    name: str
    kind: Any
    values: int | None
    required: bool
    positional: bool


def _command(
    arguments: Sequence[str], commands: Mapping[str, Callable[..., Any]]
) -> tuple[list[str], list[str]]:
    """The words of the command, as far as they are known, and the arguments after them."""
    words: list[str] = []
    for word in arguments:
        longer = " ".join([*words, word])
        if not any(name == longer or name.startswith(f"{longer} ") for name in commands):
            break
        words.append(word)
        if longer in commands:
            break
    return words, list(arguments[len(words) :])


def _of_command(words: list[str], rest: list[str], commands: Iterable[str]) -> str | None:
    """What is wrong with the command itself; None if there is one."""
    command = " ".join(words)
    if command in commands:
        return None
    depth = len(words)
    known = dict.fromkeys(
        name.split()[depth] for name in commands if name.split()[:depth] == words and len(name) > len(command)
    )
    listed = ", ".join(known)
    what = f"a command of {command}" if words else "a command"
    if not rest:
        return f"name {what}: {listed}"
    if rest[0].startswith("-"):
        return f"unknown option {_short(rest[0])}; name {what} first: {listed}"
    guess = get_close_matches(rest[0], known, 1, _ALIKE)
    unknown = f"unknown command {' '.join([*words, _short(rest[0])])}"
    if guess:
        return f"{unknown}; did you mean {' '.join([*words, *guess])}?"
    return f"{unknown}; there are {listed}"


def _of_options(rest: list[str], options: Sequence[_Option]) -> str:
    """What is wrong with the options and values of a known command."""
    named = {option.name: option for option in options if not option.positional}
    values: list[str] = []
    waiting = list(rest)
    while waiting:
        word = waiting.pop(0)
        if not _is_option(word):
            values.append(word)
            continue
        name, equals, attached = word.partition("=")
        name = name.replace("_", "-")
        option = named.get(name)
        if option is None:
            guess = get_close_matches(name, named, 1, _ALIKE)
            return f"unknown option {_short(name)}" + (f"; did you mean {guess[0]}?" if guess else "")
        if option.values == 0:
            if equals:
                return f"{name} takes no value; got {_short(attached)!r}"
            continue
        given = [attached] if equals else []
        while (
            waiting and not _is_option(waiting[0]) and (option.values is None or len(given) < option.values)
        ):
            given.append(waiting.pop(0))
        wrong = _of_values(option, given)
        if wrong is not None:
            return wrong
    return _of_positionals(values, options)


def _of_values(option: _Option, given: Sequence[str]) -> str | None:
    """What is wrong with the values of an option; None if nothing is."""
    wanted = _in_words(option.kind)
    if option.values is not None and len(given) < option.values:
        if option.values > 1:
            wanted = f"{option.values} values, each {wanted}"
        return f"{option.name} needs {wanted}" + (f"; got only {_short(given[0])!r}" if given else "")
    for value in given:
        if not _fits(value, option.kind):
            return f"{option.name} must be {wanted}; got {_short(value)!r}"
    return None


def _of_positionals(values: Sequence[str], options: Sequence[_Option]) -> str:
    """What is wrong with the arguments without a name, or which argument is missing."""
    expected = [option for option in options if option.positional]
    if len(values) < len(expected) and all(option.values == 1 for option in expected):
        missing = ", ".join(option.name for option in expected[len(values) :])
        return f"missing argument {missing}"
    if len(values) > len(expected) and all(option.values == 1 for option in expected):
        return f"one argument too many: {_short(values[len(expected)])!r}"
    missing = ", ".join(option.name for option in options if option.required and not option.positional)
    return f"missing option {missing}" if missing else "the command cannot be read"


def _options(kind: Callable[..., Any]) -> list[_Option]:
    """The options of a command, by the fields of its class."""
    assert isinstance(kind, type)
    hints = get_type_hints(kind, include_extras=True)
    found = []
    for each in fields(kind):
        hint = hints[each.name]
        marks: list[Any] = []
        if get_origin(hint) is Annotated:
            hint, *marks = get_args(hint)
        renamed = next((mark.name for mark in marks if getattr(mark, "name", None)), None)
        positional = any("Positional" in repr(mark) for mark in marks)
        name = str(renamed or each.name).replace("_", "-")
        name = f"no-{name}" if each.default is True else name  # a switch that is on is switched off
        required = each.default is MISSING and each.default_factory is MISSING
        value, count = _value_of(hint)
        found.append(_Option(name.upper() if positional else f"--{name}", value, count, required, positional))
    return found


def _value_of(hint: Any) -> tuple[Any, int | None]:
    """The type of one value, and the number of values; None: any number."""
    if get_origin(hint) in (Union, types.UnionType):
        hint = next(part for part in get_args(hint) if part is not type(None))
    if hint is bool:
        return bool, 0
    if get_origin(hint) is tuple:
        parts = get_args(hint)
        return parts[0], None if parts[-1] is Ellipsis else len(parts)
    return hint, 1


def _fits(value: str, kind: Any) -> bool:
    if get_origin(kind) is Literal:
        return value in map(str, get_args(kind))
    if kind in (int, float):
        try:
            kind(value)
        except ValueError:
            return False
    return True


def _in_words(kind: Any) -> str:
    if get_origin(kind) is Literal:
        *most, last = map(str, get_args(kind))
        return f"{', '.join(most)} or {last}" if most else last
    return {int: "a whole number", float: "a number", Path: "a file name"}.get(kind, "a value")


def _is_option(word: str) -> bool:
    """Whether a word is an option's name: a negative number is not."""
    return word.startswith("-") and word.lstrip("-")[:1].isalpha() and word.lower() not in ("-inf", "-nan")


def _short(value: str) -> str:
    return value if len(value) <= _LONGEST else f"{value[: _LONGEST - 1]}…"
