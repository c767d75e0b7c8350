"""The ledger: how large each package is and how long the kernels compile, under limits that sink.

    python -m tests.ledger             # as in make check: prints the table, fails where a limit is exceeded
    python -m tests.ledger --lower     # lowers the limits to what is there now
    python -m tests.ledger --compile   # measures the compilation again, after a change of a kernel

The limits are in ``tests/ledger.md``. A row whose limit rises needs a reason in its column *why*, which no
earlier version of the row with a lower limit has in git's history.

code: lines with a token of Python that is neither comment nor docstring.
tokens: such tokens.
modules: files of Python.
numbers: numeric literals but 0, 1, 2 and powers of ten.
CPU s: CPU seconds of compiling all kernels.
"""

import argparse
import ast
import hashlib
import io
import os
import re
import shutil
import subprocess
import sys
import tempfile
import tokenize
from collections import Counter
from math import ceil
from pathlib import Path

ROOT = Path(__file__).parents[1]
FILE = ROOT / "tests" / "ledger.md"
PACKAGES = ("fusion", "devices", "recordings", "viewer_app", "tests")
KERNELS = "kernels"
SECONDS = "CPU s"
FIGURES = ("code", "tokens", "modules", "numbers", SECONDS)
_ROW = re.compile(r"^\| `(\w+)` \|(.*)\|$", re.MULTILINE)
_MEASURED = re.compile(r"`([0-9a-f]{12})` compiled in ([0-9.]+) s")
_LAYOUT = {
    tokenize.COMMENT, tokenize.NL, tokenize.NEWLINE, tokenize.INDENT, tokenize.DEDENT, tokenize.ENDMARKER
}  # fmt: skip
_SCOPES = ast.Module, ast.ClassDef, ast.FunctionDef, ast.AsyncFunctionDef
_PLAIN = {0, 1, 2} | {10.0**k for k in range(-12, 13)}

YARDSTICK = """
import numba, numpy
@numba.njit
def yardstick(values):
    return numpy.sort(values)
yardstick(numpy.ones(3))
"""
YARDSTICK_SECONDS = 4.0
"""Compilation is stated for a machine that compiles the yardstick in this CPU time."""
NOISE = 1.25
"""A limit of seconds is this factor above a measurement: so much the yardstick varies on a busy machine."""


def counted(source):
    """The code, tokens and numbers of a module, as a Counter of :data:`FIGURES`."""
    nodes = list(ast.walk(ast.parse(source)))
    texts = [item for node in nodes if isinstance(node, _SCOPES) for item in node.body if _is_text(item)]
    documented = {line for text in texts for line in range(text.lineno, text.end_lineno + 1)}
    tokens = [
        token
        for token in tokenize.generate_tokens(io.StringIO(source).readline)
        if token.type not in _LAYOUT and token.start[0] not in documented
    ]
    lines = {line for token in tokens for line in range(token.start[0], token.end[0] + 1)}
    values = [abs(node.value) for node in nodes if _is_value(node, int, float)]
    numbers = sum(value not in _PLAIN for value in values)
    return Counter(code=len(lines), tokens=len(tokens), modules=1, numbers=numbers)


def _is_text(statement):
    return isinstance(statement, ast.Expr) and _is_value(statement.value, str)


def _is_value(node, *types):
    return isinstance(node, ast.Constant) and type(node.value) in types


def rooms(root=ROOT):
    """The figures of each package and of each of its rooms, by name: ``fusion``, ``fusion/solvers``."""
    found = {}
    for package in PACKAGES:
        for module in sorted((root / package).rglob("*.py")):
            parts = module.relative_to(root / package).parts
            of_module = counted(module.read_text(encoding="utf-8"))
            for room in (package, f"{package}/{parts[0] if len(parts) > 1 else '.'}"):
                found.setdefault(room, Counter()).update(of_module)
    return found


def kernels_digest(root=ROOT):
    """A digest of all kernels and of the options of their compilation, without comments and layout."""
    digest = hashlib.sha256()
    for package in PACKAGES[:-1]:
        for module in sorted((root / package).rglob("*.py")):
            tree = ast.parse(module.read_text(encoding="utf-8"))
            options = module.parent.name == "compiling"
            for node in tree.body:
                if _is_kernel(node) or (options and isinstance(node, ast.Assign | ast.AnnAssign)):
                    digest.update(ast.dump(node).encode())
    return digest.hexdigest()[:12]


def _is_kernel(node):
    return isinstance(node, ast.FunctionDef) and any(
        re.search("kernel|njit", ast.unparse(decorator)) for decorator in node.decorator_list
    )


def limits_of(text):
    """The rows of a ledger: by name, their limits by figure and the reason of the last rise."""
    rows = {}
    for name, cells in _ROW.findall(text):
        *limits, why = (cell.strip() for cell in cells.split("|"))
        known = zip(FIGURES, limits, strict=True)
        rows[name] = {figure: int(limit.replace(",", "")) for figure, limit in known if limit}, why
    return rows


def with_limits(text, rows):
    """The text of a ledger with these rows."""

    def row(match):
        limits, why = rows[match[1]]
        cells = [f"{limits[figure]:,}" if figure in limits else "" for figure in FIGURES]
        return f"| `{match[1]}` | {' | '.join(cells)} | {why} |"

    return _ROW.sub(row, text)


def earlier_versions():
    """The text of every version of the ledger in git's history."""
    if shutil.which("git") is None:
        return []
    name = FILE.relative_to(ROOT).as_posix()
    return [_git("show", f"{commit}:{name}") for commit in _git("log", "--format=%H", "--", name).split()]


def _git(*words):
    return subprocess.run(["git", *words], cwd=ROOT, capture_output=True, encoding="utf-8").stdout


def faults(rows, now, earlier):
    """One sentence for each limit that is exceeded, and for each row that rose without a reason."""
    for name, figures in now.items():
        limits, why = rows.get(name, ({}, ""))
        for figure, value in figures.items():
            if value > limits.get(figure, 0):
                yield f"{name}: {value:,} {figure}, over the limit of {limits.get(figure, 0):,}."
        for before, reason in (version[name] for version in earlier if name in version):
            risen = [figure for figure in before if limits.get(figure, 0) > before[figure]]
            if risen and why in ("", reason):
                yield f"{name}: the limit of {', '.join(risen)} was lower: say in 'why' what was replaced."
                break


def lowered(rows, now):
    """The rows with limits that are no higher than what is there."""
    return {
        name: ({figure: min(limit, now[name][figure]) for figure, limit in limits.items()}, why)
        for name, (limits, why) in rows.items()
    }


def cpu_seconds(*arguments, **environment):
    """CPU seconds, user and system, of this Python with these arguments."""
    before = os.times()
    subprocess.run([sys.executable, *arguments], cwd=ROOT, env=os.environ | environment, check=True)
    after = os.times()
    return sum(getattr(after, kind) - getattr(before, kind) for kind in ("children_user", "children_system"))


def compilation():
    """CPU seconds of compiling all kernels, without those of running them, and of the yardstick."""
    run = "-m", "tests.helpers.compiled_kernels"
    with tempfile.TemporaryDirectory() as folder:
        yardsticks = [cpu_seconds("-c", YARDSTICK)]
        cold, warm = (cpu_seconds(*run, NUMBA_CACHE_DIR=folder) for _ in range(2))
        yardsticks.append(cpu_seconds("-c", YARDSTICK))
    return cold - warm, sum(yardsticks) / len(yardsticks)


def printed(found, rows, seconds):
    """The table: each package, how far it is below its limits, and its rooms."""
    lines = [f"{'':22}" + "".join(f"{figure:>10}" for figure in FIGURES)]
    for room, figures in [*found.items(), (KERNELS, {SECONDS: seconds})]:
        lines.append(f"{room:22}" + "".join(_cell(figures.get(figure)) for figure in FIGURES))
        if limits := rows.get(room, ({}, ""))[0]:
            left = {figure: limit - figures[figure] for figure, limit in limits.items()}
            lines.append(f"{'  below the limit':22}" + "".join(_cell(left.get(f)) for f in FIGURES))
    return "\n".join(lines)


def _cell(value):
    return f"{'' if value is None else f'{value:,}':>10}"


def main(arguments=None):
    """Checks, lowers or measures."""
    parser = argparse.ArgumentParser(prog="python -m tests.ledger", description=__doc__)
    parser.add_argument("--lower", action="store_true", help="lower the limits to what is there now")
    parser.add_argument("--compile", action="store_true", help="measure how long the kernels compile")
    options = parser.parse_args(arguments)
    text = FILE.read_text(encoding="utf-8")
    if options.compile:
        seconds, yardstick = compilation()
        print(f"{seconds:.1f} CPU s to compile all kernels, {yardstick:.1f} for the yardstick")
        stated = f"`{kernels_digest()}` compiled in {seconds / yardstick * YARDSTICK_SECONDS:.1f} s"
        text = _MEASURED.sub(stated, text)
    digest, seconds = _MEASURED.search(text).groups()
    found, rows = rooms(), limits_of(text)
    now = {package: found[package] for package in PACKAGES} | {KERNELS: {SECONDS: ceil(float(seconds))}}
    if options.lower:
        rows = lowered(rows, now | {KERNELS: {SECONDS: ceil(NOISE * float(seconds))}})
        text = with_limits(text, rows)
    FILE.write_text(text, encoding="utf-8")
    print(printed(found, rows, now[KERNELS][SECONDS]))
    wrong = list(faults(rows, now, map(limits_of, earlier_versions())))
    if digest != kernels_digest():
        wrong.append("kernels: changed since they were measured: run python -m tests.ledger --compile.")
    sys.exit("\n".join(wrong) or 0)


if __name__ == "__main__":
    main()
