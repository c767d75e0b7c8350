"""No option is without effect and without a word."""

import ast
import re
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.helpers.command_line import FLAGS, command_lines, duplex, words_of
from tests.helpers.documents import ROOT
from tests.helpers.recorded_pairs import write_pair
from tests.helpers.sentences import check_sentences
from viewer_app.errors import UsageError
from viewer_app.flags import in_flags
from viewer_app.options.command_line import parsed
from viewer_app.options.needs import NEEDS, refuse_without_effect
from viewer_app.options.sensing import FuseOptions


def test_sentences_of_options():
    """Each option with a need, on a line that does not meet it and on one that does."""
    refused, accepted = set(), set()

    def told(case):
        try:
            options = parsed(case.split())
        except UsageError as refusal:
            refused.add(str(refusal).split()[0])
            return str(refusal)
        accepted.update(word for word in case.split() if word.startswith("--"))
        return f"accepted: {type(options).__name__}"

    check_sentences("options", told)
    assert refused <= accepted


@given(command_lines(), st.randoms(use_true_random=False))
def test_an_option_changes_the_plan_or_is_refused_in_one_line(line, random):
    """Whatever else is stated, and in any order."""
    command, stated, chosen = line
    try:
        plan, refusal = parsed(words_of(command, stated)), ""
    except UsageError as error:
        plan, refusal = None, str(error)
    if plan is None:
        assert "\n" not in refusal
        assert any(f"--{FLAGS.get(name, name).replace('_', '-')}" in refusal for name in stated)
        return
    usual = parsed(words_of(command, {name: of for name, of in stated.items() if name not in chosen}))
    for name in chosen:
        given_, default = getattr(plan, name), getattr(usual, name)
        value = stated[name]
        said = given_[0] if isinstance(given_, tuple) else given_
        assert said is True if value is None else type(said)(value) == said
        assert (plan != usual) or given_ == default
    arguments, *options = re.split(" (?=--)", " ".join(words_of(command, stated)))
    random.shuffle(options)
    assert parsed(" ".join([arguments, *options]).split()) == plan


def test_every_need_is_shown_in_both_ways():
    page = (Path(__file__).parents[1] / "data" / "sentences" / "options.txt").read_text(encoding="utf-8")
    for need in NEEDS:
        flags = [f"--{name.replace('_', '-')}" for name in need.options]
        assert any(f"{flag} {need.what}." in page for flag in flags), need


def test_a_batch_refuses_an_option_that_no_pair_has_a_use_for(tmp_path, capsys):
    given = {"tracker": "k4abt", "unit": "cm"}
    of_csv, of_mkv = (FuseOptions(a=Path(f"a.{end}"), b=Path(f"b.{end}"), **given) for end in ("csv", "mkv"))
    refuse_without_effect(of_csv, of_mkv)
    for alone, option in ((of_csv, "tracker"), (of_mkv, "unit")):
        with pytest.raises(UsageError, match=f"^--{option} needs "):
            refuse_without_effect(alone, alone)
    write_pair(tmp_path / "pairs")
    assert duplex("batch", tmp_path / "pairs", "--out", tmp_path / "out", "--tracker", "k4abt") == 2
    assert "--tracker needs a recording of images" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


# --- Messages name parameters, and the command line makes flags of them.


_COMMAND = re.compile(
    r"\b(duplex|pip|npm|k4arecorder|pytest)\b|\{COMMAND|without --no-deps|"  # as somebody types it
    r"^--[a-z-]+(=[a-z:]+)?$|^ --"  # an argument of a command that is run, or a part of one to type
)
words = st.text(st.characters(blacklist_characters="`"), max_size=30)
names = st.from_regex(r"[a-z][a-z0-9_]{0,12}", fullmatch=True)


@given(before=words, name=names.filter(lambda name: name != "offset_ms"), value=words, after=words)
def test_a_parameter_becomes_a_flag_of_the_same_length_and_nothing_else_changes(before, name, value, after):
    flag = f"--{name.replace('_', '-')}"
    assert in_flags(f"{before} `{name}` {after}") == f"{before} {flag} {after}"
    assert in_flags(f"{before} (`{name}={value}`, {after}") == f"{before} ({flag} {value}, {after}"
    for of_file in (f"x`{name}`.csv", f"a/`{name}`", f"`{name}`.csv", f"`{name}`/b.csv", f"`{name}`-2"):
        assert in_flags(f"{before} {of_file}: {after}") == f"{before} {of_file}: {after}"
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
