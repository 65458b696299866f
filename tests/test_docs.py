"""The documentation builds without warnings, and everything has its place in it."""

from __future__ import annotations

import os
import pkgutil
import re
import subprocess
import sys
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote, urldefrag

import pytest
from once_probe import once, shared

import massprop_drake

DOCS = Path(__file__).parent.parent / "docs"
SITE = "MASSPROP_SITE"  # where `make docs` has built the site

pytestmark = pytest.mark.documentation


class Page(HTMLParser):
    """What a page links to and loads, and the places in it that can be linked to."""

    def __init__(self, path: Path):
        super().__init__()
        self.links: list[str] = []
        self.loads: list[str] = []
        self.anchors: set[str] = set()
        self.feed(path.read_text(encoding="utf-8"))

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        given = {name: value for name, value in attrs if value}
        self.anchors.add(given.get("id", ""))
        if tag == "a" and "href" in given:
            self.links.append(given["href"])
        elif tag in ("img", "script", "object") or given.get("rel") in ("stylesheet", "icon"):
            self.loads += [given[name] for name in ("src", "href", "data") if name in given]


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The site that `make docs` has built; else one of our own, whose tables of contents lack functions, in a third."""
    if SITE in os.environ:
        return Path(os.environ[SITE]).resolve()
    pytest.importorskip("sphinx", reason="Sphinx is not installed: pip install '.[docs]'")
    pytest.importorskip("myst_parser", reason="myst-parser is not installed: pip install '.[docs]'")
    pytest.importorskip("furo", reason="furo is not installed: pip install '.[docs]'")
    built = once(shared(tmp_path_factory) / "site", _build)
    assert (built / "said").read_text(encoding="utf-8") == "0"
    return built / "html"


# the nodes of the pages live to the end: looking for garbage among them takes a fifth of the time.
# In a file: for "-c", Python 3.13 takes these lines for the source of whatever calls itself "<string>",
# as what the standard library makes of a NamedTuple does, and Sphinx then reads its defaults here.
SPHINX = """
import gc, sys
from sphinx.cmd.build import main
gc.set_threshold(200_000, 50, 1000)
sys.exit(main(sys.argv[1:]))
"""


def _build(folder: Path) -> None:
    """Builds the site, and keeps what Sphinx said, which itself uses what it deprecates."""
    folder.mkdir()
    options = ["-q", "-n", "-D", "toc_object_entries=0", "-d", folder / "doctrees"]
    script = folder / "build.py"
    script.write_text(SPHINX, encoding="utf-8")
    command = [sys.executable, script, *options, DOCS, folder / "html"]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    (folder / "said").write_text(f"{done.returncode}{done.stderr}", encoding="utf-8")


@pytest.fixture(scope="module")
def pages(site: Path) -> dict[Path, Page]:
    return {path: Page(path) for path in site.rglob("*.html")}


def test_links_between_pages_lead_somewhere(pages: dict[Path, Page]) -> None:
    broken = []
    for path, page in pages.items():
        for link in (*page.links, *page.loads):
            if re.match(r"[a-z]+:", link):
                continue
            file, anchor = urldefrag(link)
            target = (path.parent / unquote(file).partition("?")[0]).resolve() if file else path
            # what a theme's script fills in has no anchor in the file
            missing = target in pages and anchor and anchor not in pages[target].anchors
            if not target.exists() or missing:
                broken.append(f"{path.name}: {link}")
    assert broken == []


def test_pages_read_offline(pages: dict[Path, Page]) -> None:
    remote = [f"{path.name}: {source}" for path, page in pages.items() for source in page.loads if "//" in source]
    assert remote == []


def test_equations_are_drawn_with_their_numbers(site: Path) -> None:
    text = (site / "theory" / "rotation.html").read_text(encoding="utf-8")
    assert '<math xmlns="http://www.w3.org/1998/Math/MathML" display="block">' in text
    assert "(2-121)</span>" in text
    assert "\\tag" not in text


def test_every_public_module_is_in_the_reference(pages: dict[Path, Page]) -> None:
    anchors = set().union(*(page.anchors for path, page in pages.items() if path.parent.name == "reference"))
    folders = [str(folder) for folder in massprop_drake.__path__]
    modules = [module.name for module in pkgutil.walk_packages(folders, "massprop_drake.") if not module.ispkg]
    # entries are what the reproduction holds, not what it offers
    names = [name for name in modules if ".entries." not in name and name != "massprop_drake.__main__"]
    missing = sorted(
        name for name in names if f"module-{name}" not in anchors and not name.rpartition(".")[2].startswith("_")
    )
    assert missing == [], "add them to a page of docs/reference/"


def test_docstrings_show_as_text(site: Path) -> None:
    """What is not reStructuredText in them has been rewritten."""
    text = (site / "reference" / "systems.html").read_text(encoding="utf-8")
    assert "<strong>Ports</strong>" in text
    assert 'body_state</span> <span class="pre">(in,</span>' in text
    assert "--&gt;" in (site / "reference" / "diagrams.html").read_text(encoding="utf-8")


def test_limits_are_assumptions_and_leave_figures_to_the_card() -> None:
    text = (DOCS / "limits.md").read_text(encoding="utf-8")
    assert len(text.split()) <= 900
    assert re.findall(r"\d+ of \d+|\d+(?:\.\d+)? sigma|--first|seeds?\b", text) == []
    assert "(card.md)" in text


def test_every_picture_is_shown_and_made_by_code(site: Path) -> None:
    shown = {path.name for path in (site / "_images").iterdir()}
    drawn = {path.name for path in (DOCS / "images").iterdir()}
    readme = (DOCS.parent / "README.md").read_text(encoding="utf-8")
    assert shown <= drawn
    assert {name for name in drawn - shown if name not in readme} == set()
    makers = (DOCS / "make_images.py", DOCS.parent / "benchmarks" / "speed.py")
    code = "".join(path.read_text(encoding="utf-8") for path in makers)
    assert [name for name in drawn if name.rpartition(".")[0] not in code] == []
