"""The sentences that users meet, each below what leads to it: ``tests/data/sentences``."""

import json
import os
import re
import shlex
from pathlib import Path
from textwrap import indent

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

    Before the command, a line may state files, as in ``m.csv='name,a\\nwalk,one.csv\\n'``.
    """

    def files():
        return {path: (path.stat().st_mtime_ns, path.stat().st_size) for path in folder.rglob("*")}

    def told(line):
        words = shlex.split(line)
        while words and (made := re.fullmatch(r"(\w+\.\w+)=(.*)", words[0])):
            text = made[2].encode().decode("unicode_escape")
            (folder / made[1]).write_text(text, encoding="utf-8")
            words.pop(0)
        before = files()
        capsys.readouterr()
        assert duplex(*filter(None, words)) == 2, line
        assert files() == before, line
        said = one_line(capsys).removeprefix("duplex: ").rstrip("\n").replace(str(folder), "FOLDER")
        return re.sub(
            r"(unknown host .*?) \(.*?\)|(Cannot listen on .*?:) .*?\.", r"\1\2", said
        )  # the system's words

    return told


def arguments(case):
    """What a case such as ``seconds=3.0 remote="B"`` states, by its names; nothing for ``-``."""
    stated = (each.partition("=") for each in case.split() if "=" in each)
    return {name: json.loads(value) for name, _, value in stated}
