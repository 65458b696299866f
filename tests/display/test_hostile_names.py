"""Text from a user's files is shown as it is and never runs: every payload in every text field, on every page.

`MASSPROP_HOSTILE=all` opens every page once per payload, each time with another payload in each field; without it
one such round is made.
"""

from __future__ import annotations

import csv
import html
import os
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from telemetry_probe import Log

from massprop_drake import load_scenario
from massprop_drake.display import write_replay, write_report
from massprop_drake.display.page import report_html, summary_html
from massprop_drake.display.run import Run
from massprop_drake.display.stage import MeshcatStage
from massprop_drake.errors import InputError
from massprop_drake.inputs.model import Model, validate_data
from massprop_drake.inputs.scenario import Scenario
from massprop_drake.inputs.scheduled import StuckOn
from massprop_drake.inputs.vehicle_file import Vehicle
from massprop_drake.results.detections import DetectionRecord
from massprop_drake.runners.recorded import estimate
from reproduction import report as reproduction
from reproduction.claims import AtMost, Claim, Outcome, Verdict
from reproduction.entry import Entry

RUN = "window.pwned=1"  # what a payload would do
PAYLOADS = (
    f"<script>{RUN}</script>",
    f"</script><script>{RUN}</script>",
    f"</title></style></textarea></pre></td></table><script>{RUN}</script>",
    "<!--<script>",
    f"--><script>{RUN}</script><!--",
    f"]]><![CDATA[<script>{RUN}</script>",
    f"<img src=x onerror={RUN}>",
    f"<svg/onload={RUN}>",
    f"<svg><animate onbegin={RUN} attributeName=x dur=1s></svg>",
    f"<details open ontoggle={RUN}>",
    f'<iframe srcdoc="<script>parent.{RUN}</script>"></iframe>',
    f'<object data="javascript:{RUN}"></object><embed src="javascript:{RUN}">',
    '<base href="https://example.invalid/"><link rel=stylesheet href=x.css><script src=x.js></script>',
    f'<meta http-equiv=refresh content="0;url=javascript:{RUN}">',
    f'<form action="javascript:{RUN}"><button autofocus onfocus={RUN}>',
    '<style>@import "https://example.invalid/x.css"; body{display:none}</style>',
    f'"><b onmouseover={RUN} style="position:fixed;inset:0">',
    f"' onclick='{RUN}' x='",
    f'" onfocus="{RUN}" autofocus="',
    f"` onload={RUN} `",
    f"javascript:{RUN}//",
    f'<a href="javascript:{RUN}">a link</a>',
    '<b>bold</b><br><sub>low</sub><span style="font-size:99px">large</span>',
    "{{7*7}}{% raw %}{# a comment #}",
    f"{{{{constructor.constructor('{RUN}')()}}}}",
    f"${{{RUN}}} `${{{RUN}}}`",
    "%{meta}%{customdata}%{x}{}%s%d",
    "/*NAME*/",
    "/*NARRATION*/",
    f"+({RUN})+",
    f'"+({RUN})+"',
    f'\\";{RUN};//',
    f'"}}],"text":"\\u003cscript\\u003e{RUN}\\u003c/script\\u003e',
    f"\u2028{RUN}\u2029{RUN}\n{RUN}",
    f"\u202e{RUN}\u2066\u200f",
    "__proto__",
    "null",
    100 * "<b>long ",  # a browser needs a minute for fifty times as long a name beside an axis
    f"[x](javascript:{RUN}) ![x](x) **b** | $\\href{{javascript:{RUN}}}{{x}}$ \\(x\\)",
    f"&lt;script&gt;{RUN}&lt;/script&gt; &#60;img src=x onerror={RUN}&#62; \x07\x1b[31m",
)
ALL = os.environ.get("MASSPROP_HOSTILE") == "all"
ROUNDS = range(len(PAYLOADS)) if ALL else (7,)
WATCHED = "addEventListener('securitypolicyviolation', e => console.error('policy: ' + e.violatedDirective))"


class Texts:
    """Deals a payload to each field that asks: in every round another one, so that each field meets all."""

    def __init__(self, first: int):
        self._next = first

    def __call__(self) -> str:
        self._next += 1
        return PAYLOADS[self._next % len(PAYLOADS)]


def changed(model: Model, **fields: Any) -> Any:
    """The same with other fields, whether they are allowed or not."""
    same = {name: getattr(model, name) for name in type(model).model_fields}
    return type(model).model_construct(**{**same, **fields})


def hostile(run: Run, text: Texts, failing: slice = slice(None)) -> Run:
    """A run with a payload in every text of its vehicle, scenario and results; no two jets have the same.

    `failing` picks the jets that fail: a line for each in every panel of the report takes its time.
    """
    vehicle = run.scenario.vehicle_data
    kinds = {name: f"{text()} {name}" for name in vehicle.jet_kinds}
    first = [text() for _ in vehicle.jets]
    names = [name if number < len(PAYLOADS) else f"{name} {number}" for number, name in enumerate(first)]
    sensors = {package.name: f"{text()} {package.name}" for package in vehicle.sensors}
    spoilt = changed(
        vehicle,
        name=text(),
        description=text(),
        source=text(),
        gyros=tuple(changed(package, name=sensors[package.name]) for package in vehicle.gyros),
        accelerometers=tuple(changed(package, name=sensors[package.name]) for package in vehicle.accelerometers),
        jet_kinds={kinds[name]: kind for name, kind in vehicle.jet_kinds.items()},
        jets=tuple(
            changed(jet, designation=name, kind=kinds[jet.kind], manifold=text())
            for jet, name in zip(vehicle.jets, names, strict=True)
        ),
        preferred_accelerometer=sensors[vehicle.accelerometers[0].name],
    )
    scenario = changed(
        run.scenario,
        name=text(),
        description=text(),
        vehicle=spoilt,
        failures=tuple(StuckOn(kind="stuck_on", jet=name, start_s=1.0) for name in names[failing]),
        autopilot=changed(run.scenario.autopilot, jet_kinds=tuple(kinds.values())),
    )
    (found,) = run.results.detections
    every = [found._replace(jet=name, cluster=jet.cluster) for name, jet in zip(names, vehicle.jets, strict=True)]
    results = replace(
        run.results,
        version=text(),
        scenario=scenario.name,
        vehicle=spoilt.name,
        detections=(*every, DetectionRecord(1.0, 2.0, text(), None, None, None, None, None, 30.0, 1)),
        autopilot=run.results.autopilot._replace(jets_out_of_use=names, jets_left_in=names),
        provenance=run.results.provenance._replace(telemetry=text(), drake=text()),
        data_quality={
            "warnings": [f"column '{text()}' is not used; is '{text()}' meant?"],
            "unknown_columns": {text(): text()},
            "missing": dict.fromkeys(sensors.values(), 2),
            text(): {text(): {text(): text()}},
        },
    )
    signals = {sensors.get(name, name): value[::4] for name, value in run.signals.items()}
    return Run(scenario, results, run.time_s[::4], signals, run.state)


def shown(text: str) -> str:
    """A text as a browser may show it: white space is one blank, what has no glyph may be left out."""
    return " ".join(text.replace("\x07", "").replace("\x1b", "").split())


@pytest.fixture
def visited(opened: Any) -> Iterator[Any]:
    """A function that opens a page, lets it go through its paces and makes sure that nothing ran or was asked for."""

    def visit(path: Path, act: str = "0", ready: str = "body[data-ready=yes]") -> Any:
        page = opened(path, WATCHED, ready)
        page.page.evaluate(act)
        page.page.wait_for_timeout(100)
        assert page.said == []
        assert page.page.evaluate("window.pwned === undefined && frames.length === 0")
        assert page.page.locator("iframe, object, embed, base, form, [onerror], [onload], [onclick]").count() == 0
        assert page.page.locator("a[href^='javascript:']").count() == 0
        if ready != "strong":  # a part of another's page
            require_strict(page.page.get_attribute("meta[http-equiv=Content-Security-Policy]", "content"))
        return page.page

    return visit


def require_strict(text: str) -> None:
    """Requires a policy by which nothing runs but the page's own scripts."""
    policy = {directive: sources for directive, _, sources in (part.partition(" ") for part in text.split("; "))}
    assert policy["default-src"] == policy["base-uri"] == policy["form-action"] == "'none'"
    assert all(source.startswith("'sha256-") for source in policy["script-src"].split() if source != "'none'")
    assert not any(scheme in text for scheme in ("unsafe-eval", "http:", "https:", "*"))


def words(page: Any, selector: str) -> list[str]:
    return [shown(text) for text in page.locator(selector).all_text_contents()]


HOVER = """for (const plot of document.querySelectorAll(".js-plotly-plot")) {
  plot.data.slice(0, 6).forEach((trace, number) => trace.visible !== false && trace.y.length
    && Plotly.Fx.hover(plot, [{ curveNumber: number, pointNumber: trace.y.findIndex(value => value !== null) }],
                       [(trace.xaxis || "x") + trace.yaxis]));
}"""


def folder_named(text: str, parent: Path) -> Path:
    """A folder that has a text in its name, as far as a file system takes it."""
    folder = parent / text.replace("/", "\u2215").replace("\0", "")[:60]
    folder.mkdir()
    return folder


@pytest.mark.parametrize("first", ROUNDS)
def test_the_report(visited: Any, stuck_run: Run, tmp_path: Path, first: int) -> None:
    run = hostile(stuck_run, Texts(first), slice(3))
    folder = folder_named(PAYLOADS[first], tmp_path)
    page = visited(write_report(run, folder / "report.html", replay=f"javascript:{RUN}"), HOVER)
    assert words(page, "h1") == [shown(f"{run.results.vehicle}: {run.results.scenario}")]
    jets = run.scenario.vehicle_data.jets
    page.click("#plot-jets summary")
    page.wait_for_selector("#plot-jets .ytick text")
    assert set(words(page, "#plot-jets .ytick text")) == {shown(f"{jet.designation} ({jet.cluster})") for jet in jets}
    known = words(page, "#plot-failure_magnitude .legendtext")
    assert {shown(f"truth of {jet.designation}") for jet in (jets[28], *jets[:3])} <= set(known)
    (*each, rest) = [line for line in words(page, "#verdict li") if line.startswith("Found")]
    assert all(shown(f"jet {jet.designation} (cluster") in line for jet, line in zip(jets, each, strict=False))
    assert len(each) == 6
    assert all(shown(f"jet {jet.designation}: stuck on") in rest for jet in jets[6:])


@pytest.mark.parametrize("first", ROUNDS)
def test_the_replay(visited: Any, stuck_run: Run, tmp_path: Path, first: int) -> None:
    run = hostile(stuck_run, Texts(first))
    folder = folder_named(PAYLOADS[first], tmp_path)
    page = visited(write_replay(run, folder / "replay.html"), "massprop.seek(5)")
    assert words(page, "h1") == [shown(f"{run.scenario.vehicle_data.name}: {run.scenario.name}")]
    (now,) = words(page, "#mp-now")
    jets = run.scenario.vehicle_data.jets
    assert all(shown(f"failed: jet {jet.designation}: stuck on") in now for jet in jets)


@pytest.mark.parametrize("first", ROUNDS)
def test_the_notebook_and_the_reproduction(visited: Any, stuck_run: Run, tmp_path: Path, first: int) -> None:
    text = Texts(first)
    run = hostile(stuck_run, text)
    path = tmp_path / "notebook.html"
    head = '<!DOCTYPE html><meta charset="utf-8"><link rel="icon" href="data:,">'
    path.write_text(f"{head}{summary_html(run)}", encoding="utf-8")
    page = visited(path, ready="strong")
    assert words(page, "strong") == [shown(f"{run.results.vehicle}: {run.results.scenario}")]
    claim = Claim(1, text(), text(), AtMost(1.0), lambda _: 0.0, text())
    outcome = Outcome(claim, np.zeros(1), 0.0, Verdict.DIFFERS, 0.0, text())
    (tmp_path / "a.png").write_bytes(bytes.fromhex(PIXEL))
    reproduced = reproduction.Reproduced(Entry(text(), text(), {}, ()), (outcome,), (Path("a.png"),))
    reproduction.write(tmp_path, [reproduced])
    page = visited(tmp_path / "reproduction.html", ready="table")
    assert words(page, "td")[:3] == [shown(claim.text), claim.source, shown(claim.thesis)]
    assert page.evaluate("document.querySelector('img').naturalWidth") == 1


PIXEL = (
    "89504e470d0a1a0a0000000d4948445200000001000000010806000000"
    "1f15c4890000000d49444154789c6360606060000000050001a5f645400000000049454e44ae426082"
)


def test_a_record_with_hostile_columns_in_a_hostile_file(toy_data: Any, tmp_path: Path) -> None:
    vehicle = validate_data(Vehicle, {**toy_data, "name": PAYLOADS[0]})
    log = Log(vehicle)
    for name in (*PAYLOADS, "known_<b>torque_x"):
        log.add(name, ["0"] * len(log.rows))
    record = folder_named(PAYLOADS[6], tmp_path) / f"<img src=x onerror={RUN}>.csv"
    with record.open("w", encoding="utf-8", newline="") as file:
        csv.writer(file).writerows([log.header, *log.rows])
    scenario = changed(load_scenario("jet_pulses"), vehicle=vehicle, jet_schedule=())
    page = report_html(estimate(record, scenario))
    for text in (record.name, "column 'known_<b>torque_x' is not used; is 'known_torque_x' meant?"):
        assert f">{html.escape(text).replace('&#x27;', '&#39;')}</" in page
    assert f"<img src=x onerror={RUN}>" not in page


def test_no_text_of_the_user_reaches_the_scene(orbiter: Vehicle, stuck_run: Run) -> None:
    """The live view and the replay's scene, whose paths are numbers."""
    spoilt = hostile(stuck_run, Texts(0)).scenario.vehicle_data
    scenes = []
    for vehicle in (orbiter, spoilt):
        stage = MeshcatStage(vehicle, truth=True)
        stage.add_mark("found", 0)
        scenes.append(stage.meshcat.StaticHtml())
    assert scenes[0] == scenes[1]


def test_names_that_stand_in_telemetry_and_paths_are_refused(toy_data: dict[str, Any]) -> None:
    for text in PAYLOADS:
        toy_data["gyros"][0]["name"] = text
        if text == "null":  # a word like any other
            assert validate_data(Vehicle, toy_data).gyros[0].name == text
            continue
        with pytest.raises(InputError, match="name"):
            validate_data(Vehicle, toy_data)
        with pytest.raises(InputError, match="name"):
            validate_data(Scenario, {"name": text})
