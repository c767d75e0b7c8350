"""The page of the method's constants, from their definitions: value, tracker, meaning."""

from __future__ import annotations

import ast
import inspect
import re
from typing import Any

from fusion.body import BODIES
from fusion.estimator.constants import Constants
from fusion.facing.model import FacingConstants

_ABOUT = """# Values of the constants

[The constants](constants.md) says where they come from, [The method](method.md) how they are used. Values are
in SI units. A list has a value for each of the angles 0°, 60°, 90°, 120° and 180° between
the person's front and the sensor.
"""
_CLASSES: tuple[tuple[str, Any], ...] = (("Estimator", Constants), ("Left and right", FacingConstants))


def constant_values_page() -> str:
    """Markdown: a table for each class of constants."""
    parts = [_ABOUT]
    for title, constants in _CLASSES:
        meanings = _meanings(constants)
        rows = [f"| `{name}` | {_values(constants, name)} | {meanings[name]} |" for name in constants._fields]
        parts.append("\n".join([f"## {title}\n\n| constant | value | meaning |\n|---|---|---|", *rows, ""]))
    return "\n".join(parts)


def _values(constants: Any, name: str) -> str:
    """The value, or those of the trackers where they differ."""
    trackers: dict[str, list[str]] = {}
    for body in BODIES.values():
        value = getattr(constants.of(body), name)
        said = ", ".join(f"{one:g}" for one in value) if isinstance(value, tuple) else f"{value:g}"
        said = str(value) if isinstance(value, bool) else said
        trackers.setdefault(said, []).append(body.name)
    if len(trackers) == 1:
        return next(iter(trackers))
    return "; ".join(f"{' and '.join(names)}: {said}" for said, names in trackers.items())


def _meanings(constants: Any) -> dict[str, str]:
    """The text below each constant or the comment beside it, which neighbours without one share."""
    source = inspect.getsource(constants)
    (of_class,) = ast.parse(source).body
    assert isinstance(of_class, ast.ClassDef)
    lines, meanings, last = source.splitlines(), {}, ""
    waiting: list[str] = []
    for one in of_class.body:
        if isinstance(one, ast.AnnAssign):
            name = ast.unparse(one.target)
            if comment := lines[(one.end_lineno or 1) - 1].partition("  # ")[2]:
                meanings |= {**dict.fromkeys(waiting, last), name: comment}
                waiting, last = [], comment
            else:
                waiting.append(name)
        elif isinstance(one, ast.Expr) and waiting:
            last = ast.literal_eval(one.value)
            meanings |= dict.fromkeys(waiting, last)
            waiting = []
    return {name: _plain(text) for name, text in meanings.items()}


def _plain(text: str) -> str:
    text = re.sub(r":\w+:`\.?(?:[\w.]+\.)?(\w+)`", r"`\1`", " ".join(text.split()))
    return (text[0].upper() + text[1:].rstrip(".") + ".").replace("S*", r"S\*").replace("|", r"\|")
