"""Runs the program's commands in this process, and draws command lines from their options."""

from dataclasses import MISSING, fields
from functools import cache
from pathlib import Path
from types import SimpleNamespace, UnionType
from typing import Annotated, Literal, get_args, get_origin, get_type_hints

import pytest
from hypothesis import strategies as st

from viewer_app import cli
from viewer_app.options import command_line
from viewer_app.options.command_line import COMMANDS

command_line._program = cache(command_line._program)  # making it takes nearly all the time of parsing a line


@pytest.fixture
def parsed(monkeypatch):
    """Options of the commands that were accepted; nothing is carried out."""
    seen = []
    stand_in = SimpleNamespace(import_module=lambda _: SimpleNamespace(run=seen.append))
    monkeypatch.setattr(cli, "importlib", stand_in)
    return seen


def duplex(*arguments):
    """Runs a command in this process and returns its exit code."""
    try:
        cli.main([str(argument) for argument in arguments])
    except SystemExit as stop:
        return int(stop.code or 0)
    return 0


def one_line(capsys):
    """Returns the one line of error that a command printed."""
    said = capsys.readouterr().err
    assert said.startswith("duplex: ")
    assert said.count("\n") == 1
    assert "Traceback" not in said
    return said


FLAGS = {"start": "from", "end": "to"}
WORDS = {
    "calibrate": ("auto", "seconds:3", "c.json"),
    "axes": ("kinect", "-x,y,z"),
    "orientation": ("90", "90,0"),
    "publish": ("lab/a",),
    "motion": ("walk", "squat"),
    "kinect_a": ("000123", "zenoh:a"),
    "kinect_b": ("000456", "zenoh:b"),
    "vmc": ("39539", "127.0.0.1:39539"),
    "seconds": ("3",),
}
"""What options of free text, and some others, may have."""
ENDINGS = {"a": ".csv", "b": ".csv", "recording": ".mkv", "second": ".rrd", "session": ".rrd", "save": ".rrd"}


def kinds_of(command):
    """The type of each option of a command, by its field; without ``Annotated``."""
    options, _ = COMMANDS[command]
    hints = get_type_hints(options, include_extras=True)
    of = {each.name: hints[each.name] for each in fields(options)}
    return {name: get_args(hint)[0] if get_origin(hint) is Annotated else hint for name, hint in of.items()}


def needed(command):
    """The fields that a command line must state."""
    return [
        each.name
        for each in fields(COMMANDS[command][0])
        if each.default is MISSING and each.default_factory is MISSING
    ]


def words_of(command, stated):
    """The words of a command line that states fields; None for a switch."""
    line = command.split()
    for each in fields(COMMANDS[command][0]):
        if each.name in stated:
            value = stated[each.name]
            flag = [f"--{FLAGS.get(each.name, each.name).replace('_', '-')}"] if each.kw_only else []
            line += flag + ([] if value is None else [str(value)])
    return line


def values_of(name, kind):
    """What an option of a type may have, as text; None for a switch."""
    kinds = get_args(kind) if isinstance(kind, UnionType) else (kind,)
    choices = [choice for each in kinds if get_origin(each) is Literal for choice in get_args(each)]
    if choices or name in WORDS:
        return [str(choice) for choice in choices] or list(WORDS[name])
    if bool in kinds:
        return [None]
    if Path in kinds:
        return [f"x{ENDINGS.get(name, '.json')}"]
    if int in kinds or float in kinds:
        return ["1", "7"] if int in kinds else ["0.75", "2"]
    return ["tcp/127.0.0.1:7447" if kinds != (str,) and tuple in map(get_origin, kinds) else "x"]


@st.composite
def command_lines(draw, most=2):
    """A command, what its line must state, and up to two of its other options."""
    command = draw(st.sampled_from(sorted(COMMANDS)))
    kinds, must = kinds_of(command), needed(command)
    chosen = draw(st.lists(st.sampled_from(sorted(set(kinds) - set(must))), max_size=most, unique=True))
    stated = {name: draw(st.sampled_from(values_of(name, kinds[name]))) for name in (*must, *chosen)}
    return command, stated, tuple(chosen)
