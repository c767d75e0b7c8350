"""The messages of the program: what it prints as an error or a warning."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from pathlib import Path

_FEWEST_WORDS = 3


def messages_of(module: Path) -> dict[str, int]:
    """The messages in a module's source, with an ellipsis for each value, and their lines.

    A message is what is raised, what is printed in yellow, and any other sentence that is not a docstring.
    """
    tree = ast.parse(module.read_text(encoding="utf-8"))
    documentation = {id(node.value) for node in ast.walk(tree) if isinstance(node, ast.Expr)}
    found = {}
    for node in _texts(tree):
        text = _template(node).strip()
        if id(node) not in documentation and text.endswith((".", "?")) and len(text.split()) >= _FEWEST_WORDS:
            found[text] = node.lineno
    return found


def _texts(tree: ast.AST) -> Iterator[ast.expr]:
    """Texts that are not a part of a longer text."""
    for node in ast.iter_child_nodes(tree):
        if isinstance(node, ast.BinOp) and isinstance(node.op, ast.Add) and _is_text(node.left):
            yield node
        elif _is_text(node):
            assert isinstance(node, ast.expr)
            yield node
        else:
            yield from _texts(node)


def _is_text(node: ast.AST) -> bool:
    if isinstance(node, ast.BinOp):
        return isinstance(node.op, ast.Add) and _is_text(node.left)
    return isinstance(node, ast.JoinedStr) or (isinstance(node, ast.Constant) and isinstance(node.value, str))


def _template(node: ast.expr) -> str:
    if isinstance(node, ast.BinOp):
        return _template(node.left) + _template(node.right)
    if isinstance(node, ast.JoinedStr):
        parts = (part.value if isinstance(part, ast.Constant) else "…" for part in node.values)
        return "".join(map(str, parts))
    return str(node.value) if isinstance(node, ast.Constant) else "…"
