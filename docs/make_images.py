"""Draws the pictures of README.md and of the documentation, with the seeds that the texts name.

python docs/make_images.py
"""

from __future__ import annotations

import runpy
import shutil
import sys
import tempfile
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import NamedTuple

import matplotlib.pyplot as plt
import numpy as np

from massprop_drake import Run, load_scenario, simulate
from massprop_drake.display import graphs, write_replay, write_report
from massprop_drake.display.comparison import comparison_html
from massprop_drake.inputs.params import accelerometers, estimation_params, gyros
from massprop_drake.maths.estimation import cycle
from massprop_drake.maths.estimation.faults.fault_events import Hypothesis
from massprop_drake.maths.estimation.faults.tree import Tree

DOCS = Path(__file__).parent
IMAGES = DOCS / "images"

# what each tutorial draws into its folder, and which of it the pages show
TUTORIALS = {
    "first_run": ["mass_reciprocal.png"],
    "build_a_diagram": ["my_loop.dot"],
    "own_estimator": ["own_estimator.png"],
    "add_a_sensor": ["with_radio_gyro.dot"],
    "add_a_failure": ["failure_magnitude.png"],
    "your_own_vehicle": ["tug_center_of_mass.png"],
    "consistency": ["nis.png"],
    "probability": ["probability.png"],
    "design_a_maneuver": ["design.png"],
}
DIAGRAMS = (
    "closed_loop_overview",
    "open_loop_overview",
    "vehicle_overview",
    "vehicle_tracked_overview",
    "autopilot_overview",
    "estimation_overview",
    "replay_overview",
)


def named() -> None:
    """Draws the picture of README.md: a small leak, from its onset to the name of the jet."""
    run = simulate(load_scenario("small_satellite_leak"))
    (found,), (injected,) = run.results.detections, run.results.injected or ()
    begins_s = injected.start_s
    around = (run.time_s > begins_s - 1.0) & (run.time_s < found.time_s + 1.0)
    figure, (above, below) = plt.subplots(2, sharex=True, figsize=(9.0, 5.0), layout="constrained")
    above.plot(run.time_s[around], np.degrees(run["rate"][around]), label=[f"rate {axis}" for axis in "xyz"])
    above.set(ylabel="rate, deg/s", title=f"Jet {found.jet} of the small satellite leaks 5 % of its thrust")
    names = run.scenario.vehicle_data.designations
    for jet, probability in zip(names, run["fault_probability"][around].T, strict=True):
        look = {"color": "C3", "label": f"{jet} has failed"} if jet == found.jet else {"color": "0.6", "lw": 0.8}
        below.plot(run.time_s[around], probability, marker=".", **look)
    below.plot([], [], color="0.6", lw=0.8, label="another jet has failed")
    below.set(ylim=(-0.02, 1.02), xlabel="time, s", ylabel="probability")
    below.annotate(
        f"{found.jet} named: {found.magnitude:.4f} ± {found.magnitude_std:.4f} N",
        (found.time_s + 0.02, 0.8),
        color="C3",
    )
    for axes in (above, below):
        axes.axvline(begins_s, color="black", ls=":", label="the leak begins")
        axes.axvline(found.time_s, color="C3")
        axes.legend(loc="center left", fontsize="small")
        axes.grid(alpha=0.3)
    figure.savefig(IMAGES / "leak_named.png", dpi=100)
    plt.close(figure)


def followed_trees() -> tuple[Run, list[Tree]]:
    """Returns a run of a leak, and the hypotheses after each of its samples, from its readings alone."""
    run = simulate(load_scenario("leak_named", ["duration_s=50"]))
    params, command = estimation_params(run.scenario), run["command"]
    rates, velocities = (
        np.stack([run[one.name] for one in of(run.scenario)], axis=1) for of in (gyros, accelerometers)
    )
    state, before, trees = cycle.initial_state(params), np.zeros(command.shape[1]), []
    for time_s, rate, velocity, now in zip(run.time_s.tolist(), rates, velocities, command, strict=True):
        sample = cycle.Sample(time_s, rate, velocity, before, None, None, now)
        state, before = cycle.step(state, sample, params).state, now
        trees.append(state.detector.tree)
    return run, trees


def history_name(each: Hypothesis, names: tuple[str, ...]) -> str:
    """Returns the name of a hypothesis by its events: its jets, and whether their force drifts."""
    jets = sorted({names[jet] for jet, _ in each.ways})
    others = sorted(event.cause.kind.name.lower() for event in each.events if not event.cause.failures)
    drifting = " drifts" if (each.walks > 0.0).any() else ""
    return (" + ".join([*jets, *others]) or "nothing") + drifting


def tree() -> None:
    """Draws the hypotheses about a leak, from its onset until they are few again."""
    run, trees = followed_trees()
    (found,) = run.results.detections
    names, lowest = run.scenario.vehicle_data.designations, -30.0  # nats: what is further behind is dropped
    lines: dict[str, dict[float, float]] = {}
    for time_s, now in zip(run.time_s.tolist(), trees, strict=True):
        if found.onset_s - 0.1 < time_s < found.onset_s + 1.3:
            for each in now.hypotheses:
                weights = lines.setdefault(history_name(each, names), {})
                weights[time_s] = max(each.weight - now.leader.weight, weights.get(time_s, -np.inf))
    figure, axes = plt.subplots(figsize=(9.0, 5.0), layout="constrained")
    single = [name for name in lines if "+" not in name]
    for name, weights in lines.items():
        at, weight = np.array(list(weights)), np.array(list(weights.values()))
        color, label, width = "0.7", None, 0.8
        if name in single:
            color, label, width = f"C{single.index(name)}", name, 2.5 if name == found.jet else 1.2
        axes.plot(at, weight, color=color, label=label, lw=width)
        axes.plot(at[0], weight[0], marker="o", color=color)
    axes.plot([], [], color="0.7", lw=0.8, label="two jets")
    axes.plot([], [], color="black", marker="o", ls="", label="birth")
    axes.axvline(found.onset_s, color="black", ls=":", label="the leak begins")
    axes.axvline(found.time_s, color="black", label=f"{found.jet} is declared")
    axes.set(ylim=(lowest, 1.0), xlabel="time, s", ylabel="log weight behind the likeliest, nats")
    figure.legend(loc="outside right upper", fontsize="small")
    axes.grid(alpha=0.3)
    figure.savefig(IMAGES / "hypotheses.png", dpi=100)
    plt.close(figure)


def figures() -> None:
    """Draws figures of the sample maneuver, and of a failure after it."""
    plot = simulate(load_scenario("sample_maneuver")).plot
    failure = simulate(load_scenario("stuck_on_29")).plot
    failure.detection_timeline().savefig(IMAGES / "detection_timeline.png")
    for name in ("inverse_inertia_diagonal", "phase_plane", "innovations"):
        getattr(plot, name)().savefig(IMAGES / f"{name}.png")


class Shot(NamedTuple):
    """Page of runs as a browser shows it.

    Attributes:
        name: of the picture.
        scenarios: of the runs; of more than one it is the page that compares them.
        write: writes the page of one.
        act: what the reader does before.
    """

    name: str
    scenarios: tuple[str, ...]
    write: Callable[[Run, Path], Path] = write_report
    act: str = "0"


AT_FAILURE = "document.querySelectorAll('#jumps button')[1].click(); document.querySelector('#bar').scrollIntoView()"
SHOTS = (
    Shot("report", ("stuck_on_29",), act=AT_FAILURE),
    Shot("verdict", ("two_failures",)),
    Shot("injected", ("two_failures",), act="document.querySelector('#failures').scrollIntoView()"),
    Shot("replay", ("stuck_on_29",), write_replay, "massprop.seek(51.3)"),
    Shot("docking", ("payload_docking",), write_replay, "massprop.seek(72.5)"),
    Shot("followed", ("air_bearing_pulses",), act="document.querySelector('#plot-thrust_factors').scrollIntoView()"),
    Shot("comparison", ("stuck_on_29", "two_failures"), act="document.querySelector('#bar').scrollIntoView()"),
)


def screenshots() -> None:
    """Draws the pages of runs as a browser shows them.

    Raises:
        RuntimeError: when no Chromium is installed.
    """
    from playwright.sync_api import sync_playwright  # noqa: PLC0415 (for these alone)

    chromium = shutil.which("chromium") or shutil.which("google-chrome")
    if chromium is None:
        raise RuntimeError("no Chromium is installed to show the report in")
    runs = {name: simulate(load_scenario(name)) for shot in SHOTS for name in shot.scenarios}
    flags = ["--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"]
    with tempfile.TemporaryDirectory() as folder, sync_playwright() as driver:
        page = driver.chromium.launch(executable_path=chromium, args=flags).new_page()
        for shot in SHOTS:
            page.set_viewport_size({"width": 900, "height": 560})
            page.goto(_written(shot, runs, Path(folder) / f"{shot.name}.html").as_uri())
            page.wait_for_selector("body[data-ready=yes]", state="attached")
            page.evaluate(shot.act)
            page.wait_for_timeout(2500)
            page.screenshot(path=IMAGES / f"{shot.name}.jpg", type="jpeg", quality=80)


def _written(shot: Shot, runs: Mapping[str, Run], path: Path) -> Path:
    """Writes the page of a shot."""
    if len(shot.scenarios) == 1:
        return shot.write(runs[shot.scenarios[0]], path)
    path.write_text(comparison_html([(name, runs[name]) for name in shot.scenarios]), encoding="utf-8")
    return path


def tutorials() -> None:
    """Collects the images that the tutorials draw when they run."""
    for name, pictures in TUTORIALS.items():
        with tempfile.TemporaryDirectory() as folder:
            sys.argv = [name, folder]
            runpy.run_path(str(DOCS / "tutorials" / f"{name}.py"), run_name="__main__")
            for picture in pictures:
                source = Path(folder) / picture
                if source.suffix == ".dot":
                    draw(source.read_text(encoding="utf-8"), source.stem)
                else:
                    (IMAGES / picture).write_bytes(source.read_bytes())


def diagrams() -> None:
    """Draws the diagrams that come with the package."""
    for name in DIAGRAMS:
        draw(graphs.overview_text(graphs.build(name.removesuffix("_overview"))), name)


def draw(dot: str, name: str) -> None:
    """Draws a graph as SVG.

    Raises:
        RuntimeError: when no program that can is installed.
    """
    svg = graphs.svg_text(dot)
    if svg is None:
        raise RuntimeError("no program draws SVG: pip install graphviz-pure, or install Graphviz")
    (IMAGES / f"{name}.svg").write_text(svg, encoding="utf-8")


def main() -> None:
    """Writes the images."""
    IMAGES.mkdir(exist_ok=True)
    named()
    tree()
    figures()
    screenshots()
    tutorials()
    diagrams()


if __name__ == "__main__":
    main()
