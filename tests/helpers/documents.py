"""The documents of the project, and the commands and messages in them."""

import ast
import re
from pathlib import Path

from viewer_app.flags import in_flags

ROOT = Path(__file__).resolve().parents[2]
PACKAGES = ("fusion", "devices", "recordings", "viewer_app")
_FENCE = re.compile(r"^```sh\n(.*?)^```$", re.DOTALL | re.MULTILINE)
_BLOCK = re.compile(r"^```.*?^```$", re.DOTALL | re.MULTILINE)
_PYTHON = re.compile(r"^```python\n(.*?)^```$", re.DOTALL | re.MULTILINE)
_FIELD = re.compile(r"\{[^{}]*\}")  # of str.format
_SPAN = re.compile(r"(?<!`)`(duplex [a-z][^`\n]*)`")


def documents():
    """All documents of the project."""
    return [*sorted((ROOT / "docs").glob("*.md")), ROOT / "README.md", ROOT / "CONTRIBUTING.md"]


def words(text):
    """How many words a page has, tables included, without its blocks of code."""
    return len(_BLOCK.sub("", text).split())


def lines_of(document):
    """The lines of a document's shell blocks, without comments."""
    for block in _FENCE.findall(document.read_text(encoding="utf-8")):
        for line in block.replace("\\\n", " ").splitlines():
            if typed := line.partition(" #")[0].strip():
                yield typed


def commands_of(document):
    """The command lines of ``duplex`` in a document's shell blocks."""
    return (line for line in lines_of(document) if line.startswith("duplex "))


def python_of(document):
    """The Python blocks of a document."""
    return _PYTHON.findall(document.read_text(encoding="utf-8"))


def mentions_of(document):
    """The commands of ``duplex`` that a document mentions in its sentences."""
    yield from _SPAN.findall(document.read_text(encoding="utf-8"))


def message_templates():
    """Every text in the program, with an ellipsis for each value put into it, as the command line says it."""
    found = set()
    for package in PACKAGES:
        for module in (ROOT / package).rglob("*.py"):
            for node in ast.walk(ast.parse(module.read_text(encoding="utf-8"))):
                if isinstance(node, ast.JoinedStr):
                    parts = [part.value if isinstance(part, ast.Constant) else "…" for part in node.values]
                    found.add("".join(map(str, parts)))
                elif isinstance(node, ast.Constant) and isinstance(node.value, str):
                    found.add(_FIELD.sub("…", node.value))
    return {in_flags(text) for text in found}
