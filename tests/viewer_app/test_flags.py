"""Messages name parameters, and the command line makes flags of them."""

import ast
import re

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.helpers.command_line import duplex
from tests.helpers.documents import ROOT
from viewer_app.flags import in_flags

_COMMAND = re.compile(
    r"\b(duplex|pip|npm|k4arecorder|pytest)\b|\{COMMAND|without --no-deps|"  # as somebody types it
    r"^--[a-z-]+(=[a-z:]+)?$|^ --"  # an argument of a command that is run, or a part of one to type
)
words = st.text(st.characters(blacklist_characters="`"), max_size=30)
names = st.from_regex(r"[a-z][a-z0-9_]{0,12}", fullmatch=True)


@given(before=words, name=names.filter(lambda name: name != "offset_ms"), value=words, after=words)
def test_a_parameter_becomes_a_flag_of_the_same_length_and_nothing_else_changes(before, name, value, after):
    flag = f"--{name.replace('_', '-')}"
    assert in_flags(f"{before}`{name}`{after}") == f"{before}{flag}{after}"
    assert in_flags(f"{before}`{name}={value}`{after}") == f"{before}{flag} {value}{after}"
    assert len(in_flags(f"`{name}`")) == len(f"`{name}`")
    assert in_flags(before + after) == before + after
    assert in_flags(f"`duplex {name}`") == f"`duplex {name}`"


@pytest.mark.parametrize("package", ["fusion", "devices", "recordings"])
def test_no_text_below_the_command_line_names_a_flag(package):
    """But in a command that somebody is to type, and among the arguments of one that is run."""
    named = []
    for module in (ROOT / package).rglob("*.py"):
        tree = ast.parse(module.read_text(encoding="utf-8"))
        documents = {id(node.value) for node in ast.walk(tree) if isinstance(node, ast.Expr)}  # docstrings
        inner = {
            id(part) for node in ast.walk(tree) if isinstance(node, ast.JoinedStr) for part in node.values
        }
        for node in ast.walk(tree):
            if id(node) in documents | inner or not isinstance(node, ast.JoinedStr | ast.Constant):
                continue
            text = ast.unparse(node)[2 if isinstance(node, ast.JoinedStr) else 1 : -1]
            if re.search(r"--[a-z]", text) and not _COMMAND.search(text):
                named.append(f"{module.name}: {text}")
    assert named == []


def test_the_command_line_and_python_each_say_it_their_way(tmp_path, capsys):
    (tmp_path / "s.rrd").touch()
    assert duplex("export", tmp_path / "s.rrd", "--to", tmp_path / "s.csv", "--rate", 60) == 2
    assert "--rate is for .bvh, .c3d, .glb, .mot and .trc" in capsys.readouterr().err
