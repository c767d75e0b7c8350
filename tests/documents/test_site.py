"""The built site: every public name has an entry, and no docstring's markup is left in the text."""

import html
import inspect
import re
from importlib import import_module

import pytest

from fusion.body import BODIES
from fusion.estimator.constants import Constants
from fusion.facing.model import FacingConstants
from tests.helpers.documents import ROOT, documents
from viewer_app.options.command_line import COMMANDS, parsed

pytest.importorskip("mkdocs", reason="needs mkdocs: pip install '.[dev]'")

PUBLIC = ("fusion", "devices", "recordings")
CODE = re.compile(r"<(script|style|pre|code)\b.*?</\1>", re.DOTALL)


@pytest.fixture(scope="module")
def site(tmp_path_factory):
    """The article of each page by its name, as HTML."""
    from mkdocs.commands.build import build
    from mkdocs.config import load_config

    folder = tmp_path_factory.mktemp("site")
    build(load_config(str(ROOT / "mkdocs.yml"), site_dir=str(folder), strict=True))
    pages = [folder / "index.html", *folder.glob("*/index.html")]
    return {page.parent.relative_to(folder).as_posix(): _article(page) for page in pages}


def _article(page):
    (article,) = re.findall(r"<article.*?</article>", page.read_text(encoding="utf-8"), re.DOTALL)
    return article


def plain(markup):
    return html.unescape(re.sub(r"<[^>]+>", "", markup))


def entries(site):
    """The reference's entry of each name, as HTML."""
    parts = re.split(r'<h3 id="([^"]+)"', site["api"])
    return dict(zip(parts[1::2], parts[2::2], strict=True))


def test_every_public_name_has_an_entry_and_no_other_is_promised(site):
    shown = {name for name in entries(site) if name.count(".") == 1 and name.split(".")[0] in PUBLIC}
    modules = {"fusion.movement.joint_rotations", "fusion.movement.angles"}
    assert shown - modules == {f"{one}.{name}" for one in PUBLIC for name in import_module(one).__all__}


IMPORT = re.compile(r"^from ((?:devices|fusion|recordings)[\w.]*) import (.*)$", re.MULTILINE)


def test_every_name_that_a_document_imports_has_an_entry(site):
    pages = [page for page in documents() if page.name != "CONTRIBUTING.md"]  # it is about inner modules
    texts = [file.read_text("utf-8") for file in [*(ROOT / "examples").glob("*.py"), *pages]]
    used = {
        f"{module}.{name.strip()}"
        for text in texts
        for module, names in IMPORT.findall(text)
        for name in names.split(",")
    }
    assert len(used) > 15
    assert used - set(entries(site)) == set()


@pytest.mark.parametrize("package", PUBLIC)
def test_an_entry_has_every_argument(site, package):
    """Of functions and of constructors."""
    module, found = import_module(package), entries(site)
    for name in module.__all__:
        public = getattr(module, name)
        own = public.__init__ if inspect.isclass(public) else public
        if not inspect.isfunction(own) or own.__module__ == "enum":
            continue
        (signature,) = re.findall(
            r'<div class="[^"]*doc-signature[^"]*">(.*?)</div>', found[f"{package}.{name}"], re.DOTALL
        )[:1]
        missing = [
            argument
            for argument in inspect.signature(own).parameters
            if argument != "self" and not re.search(rf"\b{argument}\b", plain(signature))
        ]
        assert not missing, f"{package}.{name}"


def test_no_markup_is_left_in_the_text(site):
    assert len(site) > 20
    for name, article in site.items():
        prose = CODE.sub("", article)
        assert "S<em>" not in prose, f"{name}: S* is read as emphasis"
        assert not re.search(r"<blockquote>\s*<blockquote>", prose), (
            f"{name}: a doctest is read as quotations"
        )
        text = plain(prose)
        assert not re.search(r":(attr|class|data|exc|func|meth|mod):", text), f"{name}: a role of Sphinx"
        assert not re.search(r"`|\*\*|\]\(", text), f"{name}: Markdown"
        assert "\\" not in "".join(re.findall("<math.*?</math>", prose)), f"{name}: LaTeX"


OPTION = re.compile(r"(?<![\w-])--[a-z][a-z0-9-]*")


@pytest.mark.parametrize("command", COMMANDS)
def test_the_page_of_commands_says_what_the_help_says(site, command, capsys, monkeypatch):
    monkeypatch.setenv("COLUMNS", "400")
    with pytest.raises(SystemExit):
        parsed([*command.split(), "--help"])
    said = capsys.readouterr().out
    parts = re.split(r'<h2 id="([^"]+)"', site["command-line"])
    section = dict(zip(parts[1::2], parts[2::2], strict=True))[command.replace(" ", "-")]
    listed = [plain(cell) for cell in re.findall(r"<td>(.*?)</td>", section, re.DOTALL)]
    names, texts = listed[::2], listed[1::2]
    arguments = {f"--{name.lower()}" for name in names if name.isupper()}
    assert set(OPTION.findall(plain(section))) == set(OPTION.findall(said)) - arguments
    for text in texts:  # its first sentence, but for the values, which the help has in brackets
        assert " ".join(text.partition(". ")[0].split()).rstrip(".") in " ".join(
            re.sub("[│╮╯╰╭─]", "", said).split()
        )


@pytest.mark.parametrize("constants", [Constants, FacingConstants], ids=lambda cls: cls.__name__)
def test_every_constant_is_on_the_page_with_its_value(site, constants):
    rows = {
        plain(cells[0]): plain(cells[1])
        for row in re.findall(r"<tr>(.*?)</tr>", site["constant-values"], re.DOTALL)
        if len(cells := re.findall(r"<td[^>]*>(.*?)</td>", row, re.DOTALL)) == 3
    }
    for body in BODIES.values():
        for name, value in constants.of(body)._asdict().items():
            each = value if isinstance(value, tuple) else [value]
            said = ", ".join(str(one) if isinstance(one, bool) else f"{one:g}" for one in each)
            assert said in re.split("; |: ", rows[name]), f"{name} of {body.name}"
