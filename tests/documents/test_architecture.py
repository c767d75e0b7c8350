"""The documents list every folder and every long module, and name modules that exist."""

import re
import subprocess
import sys
import tomllib

import grimp
import pytest

from tests.helpers.documents import PACKAGES, ROOT, documents

FOLDER = re.compile(r"^((?:fusion|devices|recordings|viewer_app)/[a-z_0-9/]+)  +\S", re.MULTILINE)
NAMED = re.compile(r"`((?:fusion|devices|recordings|viewer_app|tests)(?:[./][a-z_0-9]+)+(?:\.py)?)`")


def exists(name):
    """Whether a dotted name or a path is a folder or a module, or a name in a module."""
    path = ROOT / name
    if "/" in name:
        return path.exists()
    parts = name.split(".")
    for length in range(len(parts), 0, -1):
        stem = ROOT.joinpath(*parts[:length])
        if stem.is_dir():
            return length == len(parts) or _defines(stem / "__init__.py", parts[length])
        if stem.with_suffix(".py").exists():
            return length == len(parts) or _defines(stem.with_suffix(".py"), parts[length])
    return False


def _defines(module, name):
    return re.search(rf"\b{name}\b", module.read_text(encoding="utf-8")) is not None


def test_each_row_of_where_to_change_what_names_what_its_modules_have():
    """Found with one look-up: a name beside a module is in it, or in another of the row."""
    page = (ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8")
    rows = page.partition("## Where to change what")[2].partition("\n## ")[0].splitlines()[4:]
    checked = 0
    for row in filter(None, rows):
        spans = re.findall("`(.*?)`", row)
        paths = [span for span in spans if "/" in span or span.endswith((".py", ".html"))]
        files = [file for path in paths for file in _files(path)]
        text = "\n".join(file.read_text(encoding="utf-8") for file in files)
        names = {re.match(r"\w+", span)[0] for span in spans if span not in paths and " " not in span}
        assert {name for name in names if not re.search(rf"\b{name}\b", text)} == set(), row
        checked += len(names)
    assert checked > 25


def _files(name):
    """The files that a path, or the name of a file alone, stands for; those of a folder."""
    path = ROOT / name
    if "/" not in name:
        found = [file for package in PACKAGES for file in (ROOT / package).rglob(name)]
    else:
        found = [*path.rglob("*.py"), *path.rglob("*.html")] if path.is_dir() else [path]
    assert found, name
    return found


def test_the_list_of_folders_is_complete():
    listed = set(FOLDER.findall((ROOT / "docs" / "architecture.md").read_text(encoding="utf-8")))
    folders = {
        module.parent.relative_to(ROOT).as_posix()
        for package in PACKAGES
        for module in (ROOT / package).rglob("*.py")
    }
    assert listed == folders - set(PACKAGES)


@pytest.mark.parametrize("page", documents(), ids=lambda page: page.name)
def test_modules_that_a_page_names_exist(page):
    named = NAMED.findall(page.read_text(encoding="utf-8"))
    assert [name for name in named if not exists(name)] == []


def test_every_long_module_has_a_reason():
    reasons = (ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8")
    for package in PACKAGES:
        for module in (ROOT / package).rglob("*.py"):
            if len(module.read_text(encoding="utf-8").splitlines()) > 300:
                assert f"| `{module.relative_to(ROOT).as_posix()}` |" in reasons


def test_no_folder_has_more_than_twelve_modules():
    for package in PACKAGES:
        for folder in [ROOT / package, *(path for path in (ROOT / package).rglob("*") if path.is_dir())]:
            modules = [path for path in folder.glob("*.py") if path.name != "__init__.py"]
            if folder != ROOT / "viewer_app/commands":  # one per command
                assert len(modules) <= 12, folder


def test_a_session_leads_to_no_sensor_no_tracker_and_not_to_everything():
    """Imports within functions count."""
    graph = grimp.build_graph(*PACKAGES, exclude_type_checking_imports=True)
    reached = graph.find_upstream_modules("recordings.session")
    contracts = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["importlinter"]["contracts"]
    apart = next(each["modules"] for each in contracts if each["type"] == "independence")
    own = [name for name in apart if name != "devices.skeletons"] + ["devices.capture", "devices.live"]
    assert {"recordings.session_series", "recordings.gait", "recordings.export.tables"} <= reached
    assert [name for name in reached if name.startswith((*own, "viewer_app"))] == []
    assert len(reached) <= 140


READ = """
import sys
{what}
own = [module for name, module in sys.modules.items() if name.partition(".")[0] in {packages}]
lines = sum(open(module.__file__, encoding="utf-8").read().count("\\n") for module in own if module.__file__)
print(lines, sum(module.__name__.startswith("devices.") for module in own))
"""
RUN_FUSE = "from viewer_app.cli import main; main(['fuse', *{pair}, '--no-viewer'])"
PAIR = [str(ROOT / "examples" / "data" / name) for name in ("a.csv", "b.csv")]


@pytest.mark.parametrize(
    ("what", "most_lines", "most_of_devices"),
    [
        ("from fusion import Fuser", 7_050, 0),
        ("from recordings import Session", 5_870, 5),
        ("from recordings import fuse", 16_500, 25),
        (RUN_FUSE.format(pair=PAIR), 24_950, 42),
        ("import viewer_app.commands.live", 33_200, 58),
    ],
)
def test_who_reads_one_thing_need_not_read_all(what, most_lines, most_of_devices):
    """What a name imports is what its reader may have to read; so is what a command has loaded at its end."""
    program = READ.format(what=what, packages=PACKAGES)
    run = subprocess.run(
        [sys.executable, "-c", program], cwd=ROOT, capture_output=True, text=True, check=True
    )
    lines, of_devices = map(int, run.stdout.splitlines()[-1].split())
    assert 0 < lines <= most_lines
    assert of_devices <= most_of_devices
