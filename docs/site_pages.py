"""Hooks of MkDocs: pages made from files outside of this folder, links to them, and equations.

Equations become MathML, which browsers draw by themselves: the site loads no script from elsewhere.
"""

from __future__ import annotations

import ast
import json
import re
from pathlib import Path
from typing import Any

from api_page import api_page  # MkDocs finds what lies beside a hook
from command_line import command_line_page
from constant_values import constant_values_page
from latex2mathml.converter import convert
from mkdocs.structure.files import File, Files
from session_entities import entities_page

ROOT = Path(__file__).resolve().parents[1]
_COPIED = {"CONTRIBUTING.md": "contributing.md", "CHANGELOG.md": "changelog.md"}
_LINK = re.compile(r"\]\((?P<up>(?:\.\./)*)(?P<path>[^)#:]+)(?P<anchor>#[^)]*)?\)")
_CODE = re.compile(r"(?<!</span>)<code>[^<]*</code>")  # not in a block
_OPTION = re.compile(r"(?<![\w-])-{1,2}[a-z][\w-]*")
_WHOLE = r'<span class="option">\g<0></span>'
_BETWEEN = re.compile(r"(?<=[a-z])[_/](?=[a-z])", re.IGNORECASE)
_EQUATION = re.compile(r"^```math\n(.*?)^```$", re.DOTALL | re.MULTILINE)


def on_files(files: Files, config: Any) -> Files:
    """Adds the pages that are not in this folder."""
    for source, page in _COPIED.items():
        files.append(File.generated(config, page, content=(ROOT / source).read_text(encoding="utf-8")))
    files.append(File.generated(config, "examples.md", content=_examples()))
    files.append(File.generated(config, "api.md", content=api_page()))
    files.append(File.generated(config, "command-line.md", content=command_line_page()))
    files.append(File.generated(config, "constant-values.md", content=constant_values_page()))
    files.append(File.generated(config, "entities.md", content=entities_page()))
    return files


def on_page_markdown(markdown: str, page: Any, **_: Any) -> str:
    """Redirects links that leave this folder, and turns equations into MathML."""
    copied = page.file.src_uri in _COPIED.values()
    markdown = _LINK.sub(lambda link: _redirected(link, copied), markdown)
    return _EQUATION.sub(lambda equation: _mathml(equation[1]), markdown)


def on_page_content(content: str, **_: Any) -> str:
    """Marks where code may break at the end of a line: not inside of an option, but inside of a long name."""
    return _CODE.sub(lambda code: _BETWEEN.sub(r"\g<0><wbr>", _OPTION.sub(_WHOLE, code[0])), content)


def _redirected(link: re.Match[str], from_root: bool) -> str:
    path, anchor = link["path"], link["anchor"] or ""
    if not (link["up"] or from_root):
        return link[0]
    if path.startswith("docs/"):
        return f"]({path.removeprefix('docs/')}{anchor})"
    if path == "examples":
        return "](examples.md)"
    if path.startswith("examples/") and path.endswith((".py", ".ipynb")):
        return f"](examples.md#{Path(path).stem})"
    if path == "README.md":
        return f"](index.md{anchor})"
    target = _COPIED.get(path)
    return link[0] if target is None else f"]({target}{anchor})"


def _mathml(latex: str) -> str:
    equation = convert(" ".join(latex.split()), display="block")
    return f'<div class="equation">{equation}</div>\n'


def _examples() -> str:
    """The programs in ``examples/``, each with the first line of its docstring, and the notebooks."""
    parts = ["# Examples\n\nEach is a file in `examples/`, and a test runs it.\n"]
    folder = ROOT / "examples"
    for path in sorted([*folder.glob("*.py"), *folder.glob("*.ipynb")]):
        source = path.read_text(encoding="utf-8")
        body = _program(source) if path.suffix == ".py" else _notebook(source)
        parts.append(f"## {path.name} {{ #{path.stem} }}\n\n{body}\n")
    return "\n".join(parts)


def _program(source: str) -> str:
    about = (ast.get_docstring(ast.parse(source)) or "").partition("\n")[0]
    return f"{about}\n\n```python\n{source.rstrip()}\n```"


def _notebook(source: str) -> str:
    """The cells of a notebook with their outputs; its headings go below those of the page."""
    parts = []
    for cell in json.loads(source)["cells"]:
        text = "".join(cell["source"])
        if cell["cell_type"] == "markdown":
            parts.append(re.sub(r"^#", "###", text, flags=re.MULTILINE))
            continue
        parts.append(f"```python\n{text}\n```")
        for output in cell["outputs"]:
            if "text" in output:
                parts.append(f"```text\n{''.join(output['text'])}```")
            elif "image/png" in output["data"]:
                parts.append(f"![Output of the cell](data:image/png;base64,{output['data']['image/png']})")
    return "\n\n".join(parts)
