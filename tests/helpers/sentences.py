"""The sentences that users meet, each below what leads to it: ``tests/data/sentences``."""

import os
from pathlib import Path
from textwrap import indent

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
