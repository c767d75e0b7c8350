"""An extension of griffe: docstrings, which are written for Python's ``help``, as Markdown for the site.

Sphinx roles become links, doctests become code, ``S*`` is no emphasis, and two parameters that share an entry
(``a, b:``) become two.
"""

from __future__ import annotations

import importlib
import re
from typing import Any

from griffe import Class, Extension, Object

_PACKAGES = ("fusion", "devices", "recordings")
_ROLE = re.compile(r":(?P<role>class|func|meth|attr|data|exc|mod):`(?P<target>[^`]+)`")
_CODE = re.compile(r"(``.*?``|`[^`]*`)", re.DOTALL)
_DOCTEST = re.compile(r"^(?P<indent> *)>>> .*(?:\n(?P=indent)\S.*)*", re.MULTILINE)
_SHARED = re.compile(
    r"^(?P<indent> +)(?P<names>\w+(?:, \w+)+): (?P<text>.*(?:\n(?P=indent) +.*)*)$", re.MULTILINE
)
_ATTRIBUTES = re.compile(r"^Attributes:\n(?: .*\n?|\n(?= ))+", re.MULTILINE)


def _public_homes() -> dict[str, str]:
    """The path in a package of every public name, by the path in its module."""
    homes = {}
    for name in _PACKAGES:
        package = importlib.import_module(name)
        for public in package.__all__:
            found = getattr(package, public)
            if hasattr(found, "__qualname__"):
                homes[f"{found.__module__}.{found.__qualname__}"] = f"{name}.{public}"
    return homes


class Docstrings(Extension):
    """Rewrites each docstring before it is parsed."""

    def __init__(self) -> None:
        self._homes = _public_homes()

    def on_object(self, *, obj: Object, **_: Any) -> None:
        """Called with every object, once its package is loaded."""
        if obj.docstring is not None:
            inherited = _inherited_attributes(obj) if isinstance(obj, Class) else ""
            obj.docstring.value = self._markdown(obj.docstring.value + inherited, obj)

    def _markdown(self, text: str, obj: Object) -> str:
        text = _ROLE.sub(lambda role: self._link(role["target"], obj), text)
        text = _SHARED.sub(_each_its_own, text)
        text = _DOCTEST.sub(_fenced, text)
        parts = _CODE.split(text)
        parts[::2] = [part.replace("S*", r"S\*") for part in parts[::2]]
        return "".join(parts)

    def _link(self, target: str, obj: Object) -> str:
        """A link to a documented object, or its name alone where it is not documented."""
        scope = obj if obj.is_class or obj.is_module else obj.parent
        target = target.lstrip("~")
        if scope is not None and "." not in target:
            here = scope if target in scope.all_members else scope.module
            target = f"{here.path}.{target}"
        home, _, rest = target.rpartition(".")
        path = self._homes.get(target) or f"{self._homes.get(home, home)}.{rest}"
        return f'<autoref identifier="{path}" optional><code>{rest}</code></autoref>'


def _each_its_own(entry: re.Match[str]) -> str:
    first, *others = entry["names"].split(", ")
    lines = [f"{entry['indent']}{name}: As `{first}`." for name in others]
    return "\n".join([f"{entry['indent']}{first}: {entry['text']}", *lines])


def _inherited_attributes(found: Class) -> str:
    """The section on attributes of the nearest base that has one; nothing if the class has its own."""
    for one in (found, *found.mro()):
        if one.docstring is not None and (section := _ATTRIBUTES.search(one.docstring.value)):
            return "" if one is found else f"\n\n{section[0]}"
    return ""


def _fenced(example: re.Match[str]) -> str:
    indent = example["indent"]
    return f"{indent}```pycon\n{example[0]}\n{indent}```"
