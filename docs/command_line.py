"""The page of the command line, from the classes that the program parses a command line with."""

from __future__ import annotations

import ast
import inspect
import re
from collections.abc import Iterator
from dataclasses import MISSING, Field, fields
from types import UnionType
from typing import Any, Literal, NamedTuple, get_args, get_origin, get_type_hints

from cyclopts import Group, Parameter

from viewer_app.options.command_line import COMMANDS

_ABOUT = """# Command line

`duplex COMMAND --help` prints the same. All commands share [exit codes](environment.md#exit-codes).
"""
_ARGUMENTS, _OTHERS = Group("Arguments", sort_key=-1), Group("Options", sort_key=0)


class _Option(NamedTuple):
    group: Group
    name: str
    meaning: str


def command_line_page() -> str:
    """Markdown: a section for each command, with a table for each group of its options."""
    parts = [_ABOUT]
    for command, (options, _) in COMMANDS.items():
        assert isinstance(options, type)
        given = [field.name.upper() for field in fields(options) if not field.kw_only]
        usage = " ".join(["duplex", command, *given, "[options]"])
        about = _escaped(inspect.cleandoc(options.__doc__ or ""))
        parts.append(f"## {command}\n\n```sh\n{usage}\n```\n\n{about}\n")
        of_command = list(_options(options))
        for group in sorted({option.group for option in of_command}, key=lambda group: group.sort_key):
            rows = [f"| `{name}` | {meaning} |" for of, name, meaning in of_command if of == group]
            parts.append("\n".join([f"| {group.name} | |", "|---|---|", *rows, ""]))
    return "\n".join(parts)


def _options(options: type) -> Iterator[_Option]:
    texts, hints = _texts(options), get_type_hints(options, include_extras=True)
    for field in fields(options):
        kind, *stated = (
            get_args(hints[field.name]) if _is_annotated(hints[field.name]) else [hints[field.name]]
        )
        parameters = [each for each in stated if isinstance(each, Parameter)]
        (group,) = next((each.group for each in parameters if each.group), (_OTHERS,))
        name = next((each.name[0] for each in parameters if each.name), "--" + field.name.replace("_", "-"))
        if not field.kw_only:
            name = field.name.upper()
        name = "`, `".join([name, *(each.negative[0] for each in parameters if each.negative)])
        if not isinstance(group, Group):
            group = _ARGUMENTS
        yield _Option(group, name, _escaped(texts[field.name]) + _values(kind, field))


def _is_annotated(hint: Any) -> bool:
    return hasattr(hint, "__metadata__")


def _texts(options: type) -> dict[str, str]:
    """The docstring below each option of a class and of its bases."""
    texts = {}
    for one in reversed(options.__mro__[:-1]):
        (of_class,) = ast.parse(inspect.getsource(one)).body
        assert isinstance(of_class, ast.ClassDef)
        for option, text in zip(of_class.body, of_class.body[1:], strict=False):
            if isinstance(option, ast.AnnAssign) and isinstance(text, ast.Expr):
                texts[ast.unparse(option.target)] = " ".join(ast.literal_eval(text.value).split())
    return texts


def _values(kind: Any, field: Field[Any]) -> str:
    """Which values an option has, and which one without it."""
    said = ""
    if choices := _choices(kind):
        said = f" One of {', '.join(f'`{choice}`' for choice in choices)}."
    if field.default is MISSING:
        return f"{said} Required." if field.kw_only else said
    return (
        said
        if field.default in (None, (), "") or field.default is False
        else f"{said} Default: `{field.default}`."
    )


def _choices(kind: Any) -> list[str]:
    """The values of a Literal, or of one that may be None."""
    if get_origin(kind) is UnionType:
        return [value for each in get_args(kind) for value in _choices(each)]
    return [str(value) for value in get_args(kind)] if get_origin(kind) is Literal else []


def _escaped(text: str) -> str:
    return re.sub(r"([*|\[\]<>])", r"\\\1", text)
