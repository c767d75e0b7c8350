"""README and the start page, typed line by line as printed, at a desk with a screen and two Kinects."""

import re
import shutil
import tomllib
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

from recordings import Session
from tests.acceptance.conftest import copied
from tests.helpers.documents import ROOT, lines_of, python_of
from tests.helpers.pictures import shows_body, shows_skeletons
from tests.helpers.programs import typed
from tests.helpers.recorded_pairs import assert_same_session
from tests.helpers.waiting import eventually

_WITHIN = 300.0
_FACED = "--principal 000001111111"
"""What the program asks for, and says so, if two Azure Kinects are connected."""


@dataclass(frozen=True)
class Step:
    """A printed line, and what its user sees.

    Attributes:
        line: As printed; lines of one block that need each other are one step.
        says: Words that it prints.
        makes: Files and folders that it makes.
        window: Whether it opens a window.
        shows: Whether a picture of the window has what it is to show.
        live: Whether it captures from two Kinects until Ctrl-C.
        folder: Below the page's folder; its own where the line before made the same file.
        elsewhere: Why the walk does not type it.
    """

    line: str
    says: str = ""
    makes: tuple[str, ...] = ()
    window: bool = False
    shows: Callable[[np.ndarray | None], bool] = shows_skeletons
    live: bool = False
    folder: str = "."
    elsewhere: str = ""


_START_PAGE = (ROOT / "docs" / "start.md").read_text(encoding="utf-8")
(_SUMMARY,) = re.findall(r"prints this summary:\n\n```text\n(.*?)\n```", _START_PAGE, re.DOTALL)
README = (
    Step("make demo", elsewhere="test_window.py"),
    Step("make test", elsewhere="this runs in it"),
    Step("duplex fuse a.csv b.csv --save s.rrd", "Verdict", ("s.rrd",), window=True),
    Step("duplex live --save s.rrd", "Verdict", ("s.rrd",), window=True, live=True, folder="live"),
    Step("duplex live --vmc 127.0.0.1:39539", "VMC", window=True, live=True),
    Step(
        "duplex batch recordings/ --out sessions/",
        "Sessions fused: 1, failed: 0",
        ("sessions/summary.html", "sessions/walk/walk.rrd"),
    ),
    Step("duplex record walk/", "a.mkv", ("walk/a.mkv", "walk/b.mkv"), live=True),
    Step("duplex review s.rrd --html report.html", "Events", ("report.html",), window=True),
    Step("duplex compare s.rrd mocap.trc", "S*", window=True),
    Step("duplex export s.rrd --to s.bvh", "s.bvh", ("s.bvh",)),
)
START = (
    Step("python3 -m venv ~/duplex && . ~/duplex/bin/activate\npip install .", elsewhere="the test below"),
    Step(
        "duplex fuse examples/data/a.csv examples/data/b.csv --save walk.rrd",
        _SUMMARY,
        ("walk.rrd",),
        window=True,
    ),
    Step("duplex review walk.rrd", "Events", window=True),
    Step("duplex review walk.rrd --html walk.html", "Events", ("walk.html",), window=True),
    Step("duplex info walk.rrd", "frames"),
    Step("duplex export walk.rrd --to walk.bvh --rate 60", "walk.bvh", ("walk.bvh",)),
    Step("duplex trim walk.rrd --save cut.rrd --from 0.5 --to 2", "cut.rrd", ("cut.rrd",)),
    Step("duplex replay walk.rrd --save paper.rrd --method paper", "paper", ("paper.rrd",), window=True),
    Step("duplex compare walk.rrd paper.rrd", "240 frames in common", window=True, shows=shows_body),
    Step("duplex doctor", "duplex live can start"),
    Step("duplex live --save s.rrd", "Verdict", ("s.rrd",), window=True, live=True),
)
PAGES = {"README.md": README, "docs/start.md": START}


def each(steps):
    return pytest.mark.parametrize(
        "step",
        [step for step in steps if not step.elsewhere],
        ids=lambda step: step.line.partition(" -")[0].replace(" ", "_").replace("/", ""),
    )


@pytest.mark.parametrize("page", PAGES)
def test_the_walk_takes_every_line_of_the_page_in_its_order(page):
    taken = "\n".join(step.line for step in PAGES[page]).splitlines()
    assert list(lines_of(ROOT / page)) == taken


@pytest.fixture(scope="module")
def readme(tmp_path_factory, walk):
    """The folder in which README's lines are typed."""
    folder = copied(walk, tmp_path_factory.mktemp("readme"))
    copied(walk.with_name("kinect_v2_90deg_stationary"), folder / "recordings" / "walk")
    (folder / "live").mkdir()
    return folder


@pytest.fixture(scope="module")
def start(tmp_path_factory):
    """The folder in which the lines of the start page are typed."""
    folder = tmp_path_factory.mktemp("start")
    copied(ROOT / "examples" / "data", folder / "examples" / "data")
    return folder


@pytest.fixture
def take(desk, home, kinects, seen):
    """Types a line at the desk, and sees what it promises."""

    def look(step):
        assert eventually(lambda: "Rerun" in desk.titles(), _WITHIN, every=0.5), "no window"
        if step in START:  # the same commands as README's, whose pictures are looked at
            return
        (window,) = desk.windows()
        pictures = []

        def drawn():
            pictures[:] = [window.picture()]
            return step.shows(*pictures)

        shown = eventually(drawn, _WITHIN, every=0.5)
        seen(*pictures)
        assert shown, "not in the window"

    def taken(step, folder):
        folder = folder / step.folder
        of = {**desk.environment, **home}
        with_sensors = step.live or step.line == "duplex doctor"
        of |= kinects.environment if with_sensors else {}
        line = step.line
        if step.live:
            with typed(line, folder, **of) as asking:
                assert asking.code() == 2, asking.said
            assert _FACED in asking.said
            line = f"{line} {_FACED}" + ("" if "record" in line else f" {kinects.tracker}")
        with typed(line, folder, **of) as program:
            if step.live:
                assert program.says("Recording" if "record" in line else "Running"), program.said
                kinects.person_begins()
                assert "record" in line or program.says("Calibrated"), program.said
                if step.window:
                    look(step)
                for file in step.makes:  # of both sensors
                    assert "record" not in line or eventually((folder / file).is_file, _WITHIN), file
                assert program.end() == 0, program.said
            assert program.code() == 0, program.said
        assert step.says in re.sub(" +$", "", program.said, flags=re.MULTILINE)
        assert "Traceback" not in program.said
        for file in step.makes:
            assert (folder / file).stat().st_size > 1000, file
        if step.window and not step.live:
            look(step)
        assert ("Rerun" in desk.titles()) == step.window

    yield taken
    desk.close_windows()


@each(README)
def test_readme(step, readme, take, home):
    if "mocap.trc" in step.line:
        with typed("duplex export s.rrd --to mocap.trc", readme, **home) as made:
            assert made.code() == 0, made.said
    take(step, readme)


def test_what_was_captured_until_ctrl_c_is_reviewed(readme, take):
    take(Step("duplex review s.rrd", "Verdict", window=True, folder="live"), readme)


@pytest.mark.usefixtures("take")
def test_readmes_python_makes_the_session_that_the_command_makes(readme, home):
    (block,) = python_of(ROOT / "README.md")
    (readme / "block.py").write_text(block, encoding="utf-8")
    with typed("python block.py", readme, **home) as program:
        assert program.code() == 0, program.said
    assert_same_session(readme / "walk.rrd", readme / "s.rrd")


@pytest.mark.usefixtures("take")
def test_the_start_page_installs_the_program(home):
    """With the packages that are there already: .ci/package installs them afresh."""
    packages = Path(pytest.__file__).parents[1]
    where = "import viewer_app; print(viewer_app.__file__)"
    line = f'{START[0].line}\nduplex --help\npython -P -c "{where}"'
    with typed(line, ROOT, **home, PYTHONPATH=str(packages)) as program:
        assert program.code() == 0, program.said
    version = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]["version"]
    installed = Path(home["HOME"]) / "duplex"
    assert "One skeleton from two Kinects" in program.said
    assert program.said.splitlines()[-1].startswith(str(installed))
    assert list(installed.glob(f"lib/python*/site-packages/duplex_kinects-{version}.dist-info"))
    shutil.rmtree(installed)


@each(START)
def test_start(step, start, take):
    take(step, start)


@pytest.mark.usefixtures("take")
def test_what_the_start_page_made_is_whole(start):
    walk = Session.open(start / "walk.rrd")
    assert len(walk) == 240
    seconds = 1e-9 * Session.open(start / "cut.rrd").time_ns[-1]
    assert 1.5 - 0.2 < seconds <= 1.5, "of 0.5 to 2 s; frames are less than 0.1 s apart"
    assert Session.open(start / "paper.rrd").settings.method == "paper"
    assert len(Session.open(start / "s.rrd")) > 15
