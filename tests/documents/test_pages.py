"""The pages of the site: their links, their messages, their pictures."""

import math
import re
import tomllib

import numpy as np
import pytest
from packaging.version import Version

from devices.findings.rules import RULES, of_error, of_views
from fusion.setup import REVISIONS
from tests.benchmarks import page as benchmarks_page
from tests.benchmarks import results
from tests.experiments.placement_picture import PERSON_AT, a_from_b, seen_by_both
from tests.helpers.documents import PACKAGES, ROOT, documents, message_templates, words

MARKUP = re.compile(r"\[(/|bold|yellow|bold yellow)\]")
HEADING = re.compile(r"^### `(.*)`$", re.MULTILINE)
LINK = re.compile(r"\]\(([^)#\s]+)(#[^)]*)?\)")
TROUBLES = HEADING.findall((ROOT / "docs" / "troubleshooting.md").read_text(encoding="utf-8"))


def plain(message):
    """A message without the markup of colours."""
    return MARKUP.sub("", message)


@pytest.fixture(scope="module")
def templates():
    return sorted(message_templates())


@pytest.mark.parametrize("message", TROUBLES)
def test_every_message_of_the_troubleshooting_page_is_one_of_the_program(message, templates):
    words = message.rstrip("…").rstrip()  # the rest may be a value
    assert any(words in plain(template) for template in templates)


def test_every_link_between_documents_leads_somewhere():
    made = {
        "api",
        "examples",
        "contributing",
        "changelog",
        "command-line",
        "constant-values",
        "entities",
    }  # docs/site_pages.py
    pages = {f"{name}.md" for name in made}
    for document in documents():
        for path, _ in LINK.findall(document.read_text(encoding="utf-8")):
            if not re.match(r"[a-z]+:", path) and path not in pages:
                assert (document.parent / path).exists(), f"{document.name}: {path}"


FENCE = re.compile(r"^```.*?^```$", re.DOTALL | re.MULTILINE)


def test_numbered_lists_count_up():
    """A number that ends a sentence and begins a line would become a list item."""
    for document in documents():
        last = 0
        for number in re.findall(r"^ *(\d+)\. ", FENCE.sub("", document.read_text("utf-8")), re.MULTILINE):
            assert int(number) in (1, last + 1), f"{document.name}: {number} after {last}"
            last = int(number)


def test_every_picture_says_whether_it_is_simulated():
    for document in documents():
        for alt in re.findall(r"!\[(.*?)\]", document.read_text(encoding="utf-8"), re.DOTALL):
            assert re.match("Simulated|Real recording|From above", alt), f"{document.name}: {alt}"


READ = re.compile(r"""environ(?:\.get)?[\[(]"([A-Z][A-Z0-9_]+)"|"((?:DUPLEX|LIBFREENECT2)_[A-Z_]+)\"""")
OF_THE_SYSTEM = {"PYTHONPATH", "XAUTHORITY", "XDG_RUNTIME_DIR", "HOME", "K4A_DISABLE_SYNCHRONIZATION"}


def test_the_page_of_the_environment_has_every_variable():
    """That the program reads, or its tests of their own."""
    page = (ROOT / "docs" / "environment.md").read_text(encoding="utf-8")
    found = set()
    for folder in (*PACKAGES, "tests"):
        for module in (ROOT / folder).rglob("*.py"):
            names = ("".join(pair) for pair in READ.findall(module.read_text(encoding="utf-8")))
            found |= {name for name in names if folder != "tests" or name.startswith("DUPLEX_")}
    assert {"NUMBA_CACHE_DIR", "DUPLEX_SHARED", "LIBFREENECT2_PIPELINE"} <= found
    assert {name for name in found - OF_THE_SYSTEM if f"`{name}`" not in page} == set()


def test_the_extras_are_named():
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    page = (ROOT / "docs" / "troubleshooting.md").read_text(encoding="utf-8")
    assert [
        name for name in project["optional-dependencies"] if name != "dev" and f"`{name}`" not in page
    ] == []


def test_the_site_has_every_page():
    nav = (ROOT / "mkdocs.yml").read_text(encoding="utf-8")
    for page in (ROOT / "docs").glob("*.md"):
        assert f": {page.name}\n" in nav


@pytest.mark.parametrize("angle", [60.0, 90.0, 120.0])
def test_both_sensors_see_the_person_where_the_picture_says(angle):
    b = a_from_b(angle)
    assert seen_by_both(b, PERSON_AT)
    assert not seen_by_both(b, np.zeros(3)), "nobody stands in a sensor"
    to_b = b.translation - PERSON_AT
    to_a = -PERSON_AT
    cosine = to_a @ to_b / np.linalg.norm(to_a) / np.linalg.norm(to_b)
    np.testing.assert_allclose(np.degrees(np.arccos(cosine)), angle, atol=1e-6)


def test_the_newest_release_and_its_date_are_the_same_everywhere():
    """Between releases the program's version is the coming one, and CHANGELOG lists what is unreleased."""
    version = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]["version"]
    citation = (ROOT / "CITATION.cff").read_text(encoding="utf-8")
    changes = (ROOT / "CHANGELOG.md").read_text(encoding="utf-8")
    newest, date = re.search(r"^## (\d\S*) \((.*)\)$", changes, re.MULTILINE).groups()
    assert re.findall(r"^version: (.*)$", citation, re.MULTILINE) == [newest]
    assert re.findall(r'^date-released: "(.*)"$', citation, re.MULTILINE) == [date]
    cited = (ROOT / "docs" / "related.md").read_text(encoding="utf-8")
    assert f"version = {{{newest}}},\n  year = {{{date[:4]}}}" in cited
    unreleased = "## Unreleased" in changes
    assert Version(version).is_devrelease == unreleased
    assert (Version(version) > Version(newest)) == unreleased


def test_unreleased_changes_are_in_the_sections_of_keep_a_changelog():
    changes = (ROOT / "CHANGELOG.md").read_text(encoding="utf-8")
    unreleased = re.search(r"^## Unreleased$(.*?)^## \d", changes, re.MULTILINE | re.DOTALL)
    sections = re.findall(r"^### (.*)$", unreleased[1], re.MULTILINE) if unreleased else []
    order = ["Added", "Changed", "Deprecated", "Removed", "Fixed", "Security"]
    assert sections == [name for name in order if name in sections]


def test_the_page_has_the_figures_of_the_files():
    assert benchmarks_page.PAGE.read_text(encoding="utf-8") == benchmarks_page.page(), "make benchmarks"


def test_the_page_of_angles_has_the_figures_of_the_file():
    page = (ROOT / "docs" / "angles.md").read_text(encoding="utf-8")
    document = results.read("angles")
    figures = document["figures"]
    assert f"revision {document['revision']}, {document['date']})" in page
    rows = {
        cells[1]: cells[3] for cells in (line.split("|") for line in page.splitlines()) if len(cells) == 5
    }
    for names, errors in list(rows.items())[2:]:
        measured = [f"{figures['angles'][name]['rmse']:.1f}°" for name in re.findall("`(.*?)`", names)]
        assert errors.strip() == ", ".join(measured), names
    ratios = [row["stated"] / row["rmse"] for row in figures["angles"].values()]
    assert f"it is {min(ratios):.1f} to {max(ratios):.1f} times the RMSE" in page
    of_opensim = results.read("opensim")
    assert f"opensim MODEL`; revision {of_opensim['revision']}, {of_opensim['date']})" in page
    motions = "walk", "squat", "sit", "arms", "turn"
    assert f"| | {' | '.join(motions)} |" in page
    for name in ("hip_flexion", "knee_angle", "elbow_flex"):
        each = (f"{of_opensim['figures'][motion]['rmse_deg'][name]:.1f}°" for motion in motions)
        assert f"| {name.replace('_', ' ')} | {' | '.join(each)} |" in page
    strikes = figures["strikes"]
    rms, largest = (f"{1e3 * strikes[name]:.0f} ms" for name in ("rms", "largest"))
    found = f"{strikes['found']} of {strikes['found'] + strikes['missed']}"
    assert f"{found}\nstrikes were found, {rms} (RMS) and at most {largest} from" in page
    assert f"and {strikes['invented']} were invented" in page


def test_each_table_of_benchmarks_is_of_the_methods_revision():
    """It states revision and date; the figures of time are not of the method alone, and may be older."""
    page = benchmarks_page.page()
    for file in results.FOLDER.glob("*.json"):
        document, name = results.read(file.stem), file.stem
        if name not in ("speed", "latency"):
            assert document["revision"] == REVISIONS["duplex"], f"{document['command']}, make benchmarks"
        assert name in ("angles", "opensim") or benchmarks_page.measured(name) in page
    tables = re.findall(r"^(.+)\n\n\|", page, re.MULTILINE)
    assert len(tables) == 9
    for above in tables:
        assert re.search(r"Revision \d+, \d{4}-\d\d-\d\d\.$", above), above


def limits_in_words(rule):
    """The cells of a rule in the table of limits."""
    for low, high in rule.limits:
        value = f"{low:g}–{high:g}" if math.isfinite(low) and math.isfinite(high) else ""
        value = value or (
            f"≤ {high:g}" if math.isfinite(high) else f"≥ {low:g}" if math.isfinite(low) else ""
        )
        yield f"{value}{'' if rule.unit == '°' else ' '}{rule.unit}" if value else ""


def test_the_start_page_has_the_table_of_rules():
    """But what concerns only the moment, a family of trackers or a camera."""
    page = (ROOT / "docs" / "start.md").read_text(encoding="utf-8")
    rows = [
        " | ".join(["", rule.figure, *limits_in_words(rule), ""]).strip()
        for name, rule in RULES.items()
        if rule.files and rule.unit and name not in ("distance", "moved", "views", "error", "upside_down")
    ]
    rows += [
        f"| {RULES[name].figure} | "
        + ", ".join(f"{of(body).good[1]:.0f}" for body in ("azure_kinect", "kinect_v2", "blazepose"))
        + " mm | half more |"
        for name, of in (("views", of_views), ("error", of_error))
    ]
    assert [row for row in rows if row not in page] == []


def test_related_work_compares_with_the_figures_of_the_files():
    page = (ROOT / "docs" / "related.md").read_text(encoding="utf-8")
    errors = [
        results.read(f"accuracy_{name}")["figures"]["methods"]["duplex"]["mpjpe"]
        for name in ("azure", "kinect_v2")
    ]
    angles = results.read("angles")["figures"]["angles"]
    azure, kinect_v2 = (f"{1e3 * error:.0f} mm" for error in errors)
    assert f"{azure} for two Azure Kinects and {kinect_v2} for two Kinects v2" in page
    knee, hip = (f"{angles[name]['rmse']:.1f}°" for name in ("knee_flexion", "hip_flexion"))
    assert f"Ours, simulated: {knee} and {hip}" in page


def test_the_page_of_benchmarks_is_short():
    assert words(benchmarks_page.page()) <= 1790  # with the worth of each step and of depth images


def test_every_file_names_its_command_and_its_machine():
    for file in results.FOLDER.glob("*.json"):
        document = results.read(file.stem)
        assert document["command"].startswith("python -m tests.benchmarks."), file
        assert document["machine"]["processors"] >= 1
        assert document["figures"]


def test_all_documents_together_are_short():
    pages = [*documents(), ROOT / "CHANGELOG.md"]
    assert sum(words(page.read_text(encoding="utf-8")) for page in pages) <= 24_000


def test_every_test_that_a_script_names_exists():
    for script in (".ci/run", ".ci/package", "Makefile", "CONTRIBUTING.md"):
        for named in re.findall(r"\btests/[\w/]+\.py\b", (ROOT / script).read_text(encoding="utf-8")):
            assert (ROOT / named).exists(), f"{script}: {named}"
