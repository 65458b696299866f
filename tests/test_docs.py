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
SITE = "MASSPROP_SITE"  # where `make site` has built it

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


def _build(folder: Path) -> None:
    command = [sys.executable, "-m", "sphinx", "-q", "-W", "-n", "-j", "2", DOCS, folder]
    subprocess.run(command, check=True)


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    built = os.environ.get(SITE)
    return Path(built).resolve() if built else once(shared(tmp_path_factory) / "site", _build)


@pytest.fixture(scope="module")
def pages(site: Path) -> dict[Path, Page]:
    return {path: Page(path) for path in site.rglob("*.html")}


def test_links_between_pages_lead_somewhere_and_nothing_is_loaded_from_afar(pages: dict[Path, Page]) -> None:
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
    assert [source for page in pages.values() for source in page.loads if "//" in source] == []


def test_equations_and_docstrings_are_drawn(site: Path) -> None:
    text = (site / "theory" / "rotation.html").read_text(encoding="utf-8")
    assert '<math xmlns="http://www.w3.org/1998/Math/MathML" display="block">' in text
    assert "(2-121)</span>" in text
    assert "\\tag" not in text
    text = (site / "reference" / "systems.html").read_text(encoding="utf-8")
    assert "<strong>Ports</strong>" in text
    assert 'body_state</span> <span class="pre">(in,</span>' in text
    assert "--&gt;" in (site / "reference" / "diagrams.html").read_text(encoding="utf-8")


def test_every_public_module_is_in_the_reference(pages: dict[Path, Page]) -> None:
    anchors = set().union(*(page.anchors for path, page in pages.items() if path.parent.name == "reference"))
    folders = [str(folder) for folder in massprop_drake.__path__]
    modules = [module.name for module in pkgutil.walk_packages(folders, "massprop_drake.") if not module.ispkg]
    public = {name for name in modules if not name.rpartition(".")[2].startswith("_")}
    missing = sorted(name for name in public if f"module-{name}" not in anchors)
    assert missing == [], "add them to a page of docs/reference/"


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
