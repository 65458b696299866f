"""The pages on file formats say what the code says, and their examples work."""

from __future__ import annotations

import re
import sys
from pathlib import Path
from types import ModuleType

import pytest
from script_probe import script

from massprop_drake import load_scenario, simulate
from massprop_drake.cli import main as cli
from massprop_drake.display import figures
from massprop_drake.inputs.campaign_file import campaign_from, campaign_keys
from massprop_drake.inputs.model import Key, list_keys
from massprop_drake.inputs.record_map import map_keys
from massprop_drake.inputs.scenario import Scenario
from massprop_drake.inputs.vehicle_file import Vehicle
from massprop_drake.inputs.yaml import Document

DOCS = Path(__file__).parent.parent / "docs"


@pytest.fixture(scope="module")
def make_reference() -> ModuleType:
    return script(DOCS / "make_reference.py")


def yaml_examples(page: str) -> list[str]:
    text = (DOCS / page).read_text(encoding="utf-8")
    return re.findall(r"^```yaml\n(.*?)^```$", text, flags=re.DOTALL | re.MULTILINE)


@pytest.fixture
def examples(tmp_path: Path) -> Path:
    """A folder with the examples of these pages as files, named by their names."""
    for text in (
        example for page in ("getting_started", "vehicle", "scenario") for example in yaml_examples(f"{page}.md")
    ):
        name = re.match(r"name: (\w+)$", text, flags=re.MULTILINE)
        assert name is not None, text
        (tmp_path / f"{name[1]}.yaml").write_text(text, encoding="utf-8")
    return tmp_path


@pytest.mark.parametrize("name", ["vehicle.md", "scenario.md", "campaign.md", "records.md", "reference/ports.md"])
def test_page_matches_the_code(name: str, make_reference: ModuleType) -> None:
    page = (DOCS / name).read_text(encoding="utf-8")
    expected = make_reference.updated(page, make_reference.tables()[name])
    assert page == expected, "run 'python docs/make_reference.py' and commit what it writes"


@pytest.mark.parametrize(
    ("name", "found"),
    [
        ("vehicle.md", list_keys(Vehicle)),
        ("scenario.md", list_keys(Scenario)),
        ("campaign.md", campaign_keys()),
        ("records.md", map_keys()),
    ],
)
def test_page_has_every_key_once(name: str, found: list[Key]) -> None:
    _, page = (DOCS / name).read_text(encoding="utf-8").split("<!-- docs/make_reference.py")
    named = [key.name for key in found if not key.name.startswith("vehicle.")]  # on a page of its own
    if name == "scenario.md":  # parts that move inside stand on the same page, with the same keys
        theirs = {key for key in found if key.name.startswith("moving[]")}
        assert theirs <= set(list_keys(Vehicle))
        named = sorted(set(named) - {key.name for key in theirs})
    rows, headings = shown_keys(page)
    assert sorted(set(rows)) == sorted(rows)
    assert sorted(set(headings)) == sorted(headings)
    assert set(rows) | {heading for heading in headings if heading in named} == set(named)


def shown_keys(page: str) -> tuple[list[str], list[str]]:
    """Keys that tables have, and those of the mappings in their headings.

    A heading such as `a (x | y).b`, `c` stands for all of a (x).b, a (y).b and c.
    """
    rows: list[str] = []
    headings: list[str] = []
    for section in re.split(r"^### ", page, flags=re.MULTILINE)[1:]:
        heading, _, table = section.partition("\n")
        parents = [one for name in re.findall(r"`([^`]+)`", heading) for one in of_kinds(name)] or [""]
        for parent in parents:
            base = re.sub(r" \([^).]*\)$", "", parent)
            headings += dict.fromkeys(one for name in (parent, base) for one in (name, re.sub(r"\[\]$|{}$", "", name)))
        for key, kinds in re.findall(r"^\| `([^`]+)`(?: \(([^)]*)\))? \|", table, flags=re.MULTILINE):
            chosen = kinds.replace("\\", "").split(" | ") if kinds else []
            within = [one for one in parents if not chosen or any(f"({kind})" in one for kind in chosen)]
            assert len(within) >= len(chosen), key
            rows += [f"{parent}.{key}".removeprefix(".") for parent in within]
        for known in re.findall(r"^(`.+`): as in `", table, flags=re.MULTILINE):
            rows += [f"{parent}.{key}" for parent in parents for key in re.findall(r"`([^`]+)`", known)]
    return rows, list(dict.fromkeys(headings))


def of_kinds(name: str) -> list[str]:
    kinds = re.search(r" \(([^)]*)\)", name)
    return [name] if kinds is None else [name.replace(kinds[1], kind) for kind in kinds[1].split(" | ")]


def test_prose_tells_the_defaults_of_the_code(make_reference: ModuleType) -> None:
    defaults = make_reference.all_defaults()
    texts = {page: page.read_text(encoding="utf-8") for page in make_reference.pages()}
    assert sum(text.count("<!-- default ") for text in texts.values()) >= 10
    stale = [page.name for page, text in texts.items() if make_reference.told(text, defaults) != text]
    assert stale == [], "run 'python docs/make_reference.py' and commit what it writes"


def test_a_default_in_prose_is_written_anew_and_what_is_not_there_is_refused(make_reference: ModuleType) -> None:
    text = "It is <!-- default autopilot.jet_kinds -->`[primary]`, which is `[primary]`."
    written = make_reference.told(text, make_reference.all_defaults())
    assert written == "It is <!-- default autopilot.jet_kinds -->`null`, which is `[primary]`."
    with pytest.raises(ValueError, match="there is no such key"):
        make_reference.told("<!-- default nope -->`1`", {"some": "`1`"})
    with pytest.raises(ValueError, match="the page has no line"):
        make_reference.updated("# A page\n", make_reference.ports())


def test_what_pages_and_tutorials_import_is_promised() -> None:
    promised = (DOCS / "reference" / "api.md").read_text(encoding="utf-8")
    pages = [DOCS.parent / "README.md", *DOCS.glob("*.md"), *(DOCS / "tutorials").glob("*.*")]
    text = "\n".join(page.read_text(encoding="utf-8") for page in pages if page.suffix in (".md", ".py", ".ipynb"))
    imports = re.findall(r"from massprop_drake(\S*) import ([\w, ]+)", text)
    assert len(imports) > 30
    needed = {name for _, names in imports for name in names.split(", ")}
    assert [name for name in sorted(needed) if not re.search(rf"[`.]{name}`", promised)] == []


def test_examples_are_valid(examples: Path) -> None:
    scenario = load_scenario(examples / "extended_filter.yaml")
    assert (scenario.rotation.filter, scenario.mass.compensation) == ("extended", "transverse_centripetal")
    assert load_scenario(examples / "a_leaky_jet.yaml").faults.jets["R4R"].modes == ("leak",)
    assert [part.kind for part in load_scenario(examples / "servicer_that_swings.yaml").moving] == [
        "slosh",
        "panel",
        "mode",
    ]


def test_example_campaign_is_valid(tmp_path: Path) -> None:
    (text,) = yaml_examples("campaign.md")
    campaign = campaign_from(Document(text, "campaign.md"), tmp_path)
    assert len(campaign.quantities) == 10 + 3


def test_the_telemetry_pages_python_runs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (code,) = re.findall(r"^```python\n(.*?)^```$", (DOCS / "telemetry.md").read_text(encoding="utf-8"), re.S | re.M)
    monkeypatch.chdir(tmp_path)
    names: dict[str, object] = {"__name__": "telemetry"}
    exec(compile(code, "telemetry.md", "exec"), names)


@pytest.mark.documentation
def test_the_telemetry_page_shows_what_is_printed(
    examples: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    page = (DOCS / "telemetry.md").read_text(encoding="utf-8")
    monkeypatch.chdir(examples)
    simulate(load_scenario("leak.yaml")).save("run", pictures=False)
    (Path("run") / "telemetry.csv").rename("flight.csv")
    monkeypatch.setattr(figures.Plots, "all", lambda _: {})
    for command in re.findall(r"^massprop (\w+ flight\.csv .*)$", page, flags=re.MULTILINE):
        monkeypatch.setattr(sys, "argv", ["massprop", *command.split()])
        assert cli.run() == 0
    printed = [line.rstrip() for line in capsys.readouterr().out.splitlines()]
    shown = re.findall(r"^(?:flight\.csv: |[┏┃┡│├]|consistency: |samples: |detected: ).*$", page, flags=re.MULTILINE)
    assert len(shown) > 10
    missing = [line for line in shown if line not in printed]
    assert missing == []
