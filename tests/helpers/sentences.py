"""The sentences that users meet, each below what leads to it: ``tests/data/sentences``."""

import json
import os
import re
import shlex
import sys
from pathlib import Path
from textwrap import indent

import pytest

from tests.helpers.command_line import duplex, one_line

_FOLDER = Path(__file__).resolve().parent.parent / "data" / "sentences"


def check_sentences(name, told):
    """Compares what ``told`` says of each case of a file with what is indented below it there.

    Args:
        name: Of the file, without ``.txt``. A case is a line that is not indented; those with # are comments.
        told: From a case to its sentences.
    """
    path = _FOLDER / f"{name}.txt"
    before = path.read_text(encoding="utf-8")
    lines = [line for line in before.splitlines() if line[:1].strip()]
    now = [line if line[0] == "#" else f"{line}\n{indent(told(line), '    ')}" for line in lines]
    after = "\n".join(now) + "\n"
    if "REWRITE_SENTENCES" in os.environ:
        path.write_text(after, encoding="utf-8")
    else:
        assert after.splitlines() == before.splitlines()


def refusals(capsys, folder):
    """From a command line to its refusal, for :func:`check_sentences`; nothing in the folder changes.

    Before the command, a line may state files, as in ``m.csv='name,a\\nwalk,one.csv\\n'``, and a package that
    is not installed, as in ``without=pylsl``.
    """

    def files():
        return {path: (path.stat().st_mtime_ns, path.stat().st_size) for path in folder.rglob("*")}

    def told(line):
        words, missing = shlex.split(line), []
        while words and (made := re.fullmatch(r"(\w+\.\w+)=(.*)", words[0])):
            text = made[2].encode().decode("unicode_escape")
            (folder / made[1]).write_text(text, encoding="utf-8")
            words.pop(0)
        if words[0].startswith("without="):
            missing.append(words.pop(0).removeprefix("without="))
        before = files()
        capsys.readouterr()
        with pytest.MonkeyPatch.context() as patch:
            for package in missing:
                patch.setitem(sys.modules, package, None)
            assert duplex(*filter(None, words)) == 2, line
        assert files() == before, line
        said = one_line(capsys).removeprefix("duplex: ").rstrip("\n")
        said = said.replace(str(folder), "FOLDER").replace(sys.executable, "PYTHON")
        return re.sub(
            r"(unknown host .*?) \(.*?\)|(Cannot listen on .*?:) .*?\.", r"\1\2", said
        )  # the system's words

    return told


def printed(capsys):
    """From a command line to what it prints and its exit code, for :func:`check_sentences`.

    Sizes of files, the version that wrote them, and millimetres, which are those of S*, are left out.
    """

    def told(line):
        capsys.readouterr()
        code, said = duplex(*shlex.split(line)), capsys.readouterr()
        lines = [each.rstrip() for each in f"{said.out}{said.err}".splitlines()]
        told = "\n".join(each for each in (*lines, f"exit code {code}" if code else "") if each.strip())
        return re.sub(r"[\d.]+ [kM]B|at byte \d+|duplex-kinects \S+,|\d+ mm\b", "…", told)

    return told


def arguments(case):
    """What a case such as ``seconds=3.0 remote="B"`` states, by its names; nothing for ``-``."""
    stated = (each.partition("=") for each in case.split() if "=" in each)
    return {name: json.loads(value) for name, _, value in stated}
