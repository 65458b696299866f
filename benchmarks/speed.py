"""Speed: processor time of simulating and estimating, against another commit, and its scaling.

    python benchmarks/speed.py [--against COMMIT] [--repeats 5] [--scaling] [--write docs]

Both versions run in one process each, in turns, so that a busy machine strikes both alike; ratios are of neighbors,
and what is printed is their median with the least and the largest. `--scaling` measures this version alone, over
numbers of jets, accelerometers and samples. `--write` makes the page `speed.md` and its plots in a folder.
"""

from __future__ import annotations

import argparse
import gc
import json
import os
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

REPOSITORY = Path(__file__).parent.parent
ONE_THREAD = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1")
DIAGRAM, COMPILED_DIAGRAM = "diagram, numpy", "diagram, compiled"
LOOP, COMPILED_LOOP = "loop, numpy", "loop, compiled"
WAYS = {
    DIAGRAM: [],
    COMPILED_DIAGRAM: ["execution={engine: diagram, compiled: true}"],
    LOOP: ["execution.engine=loop"],
    COMPILED_LOOP: ["execution={engine: loop, compiled: true}"],
}
CASES: dict[str, dict[str, Any]] = {
    "sample_maneuver": {"scenario": "sample_maneuver"},
    "stuck_on_29": {"scenario": "stuck_on_29"},
}
JOINT = ("orbiter_maneuver", "dispersed_thrust")
CAMPAIGNS = {"sample_maneuver": ("thesis, CGLR", 25), "orbiter_maneuver": ("joint, hypotheses", 250)}
CAMPAIGN_CASES = 12
RECORD = {"numpy": [], "compiled": ["execution.compiled=true"]}
TARGETS = {
    ("sample_maneuver", COMPILED_DIAGRAM): 2.5,
    ("stuck_on_29", COMPILED_DIAGRAM): 2.0,
    ("sample_maneuver", LOOP): 3.0,
    ("sample_maneuver", COMPILED_LOOP): 15.0,
    ("stuck_on_29", COMPILED_LOOP): 6.0,
    ("estimate", "numpy"): 2.7,
    ("estimate", "compiled"): 7.0,
}
JETS, ACCELEROMETERS, LENGTHS_S = (12, 44, 100, 200), (1, 3, 6, 10), (25.0, 50.0, 100.0, 200.0)


# ------------------------------------------------------------------------------------ one version


def serve() -> None:
    """Answers requests, a JSON line each, with the processor time that they took, s."""
    from massprop_drake import estimate, load_scenario, simulate  # noqa: PLC0415 (either version)

    loaded: dict[str, Any] = {}
    for line in sys.stdin:
        request = json.loads(line)
        key = json.dumps([request["scenario"], request["overrides"]])
        if key not in loaded:
            loaded[key] = load_scenario(request["scenario"], request["overrides"])
        began = time.process_time()
        record = request.get("record")
        run = estimate(record, loaded[key]) if record else simulate(loaded[key])
        spent = time.process_time() - began
        if saved := request.get("save"):
            run.save(saved, pictures=False, report=False)
        print(json.dumps(spent), flush=True)


class Version:
    """Version of the package in a process of its own.

    Args:
        folder: that it is imported from.
    """

    def __init__(self, folder: Path):
        self._process = subprocess.Popen(
            [sys.executable, "-W", "ignore", __file__, "--serve"],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
            env={**os.environ, **ONE_THREAD, "PYTHONPATH": str(folder)},
        )

    def spent_s(self, scenario: str, overrides: list[str], **more: str) -> float:
        """Measures the processor time of a run, s."""
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        self._process.stdin.write(json.dumps({"scenario": scenario, "overrides": overrides, **more}) + "\n")
        self._process.stdin.flush()
        return float(json.loads(self._process.stdout.readline()))

    def close(self) -> None:
        """Ends the process."""
        assert self._process.stdin is not None
        self._process.stdin.close()
        self._process.wait()


def unpacked(commit: str, folder: Path) -> Path:
    """Unpacks another commit's files, with the links that make the package whole wherever they stand."""
    archive = subprocess.run(["git", "-C", REPOSITORY, "archive", commit], check=True, capture_output=True).stdout
    subprocess.run(["tar", "-x", "-C", folder], check=True, input=archive)
    for part in ("diagrams", "scenarios"):
        link = folder / "massprop_drake" / part
        if not link.exists():
            link.symlink_to(Path("..") / part)
    return folder


# -------------------------------------------------------------------------------------- comparing


def compared(here: Version, there: Version, repeats: int, folder: Path) -> list[dict[str, Any]]:
    """Measures each case by each way, with the ratios to the other version."""
    rows: list[dict[str, Any]] = []

    def measure(case: str, before: dict[str, Any], ways: dict[str, dict[str, Any]]) -> None:
        there.spent_s(**before)
        for way in ways.values():
            here.spent_s(**way)  # loads, and compiles
        spent: dict[str, list[float]] = {name: [] for name in ways}
        ratios: dict[str, list[float]] = {name: [] for name in ways}
        for _ in range(repeats):
            reference = there.spent_s(**before)
            for name, way in ways.items():
                spent[name].append(here.spent_s(**way))
                ratios[name].append(reference / spent[name][-1])
        for name in ways:
            target = TARGETS.get((case, name))
            rows.append({"case": case, "way": name, "ms": 1e3 * statistics.median(spent[name]), "target": target})
            rows[-1] |= {"ratio": statistics.median(ratios[name]), "least": min(ratios[name])}
            rows[-1] |= {"most": max(ratios[name])}
            print(_line(rows[-1]), flush=True)

    for case, request in CASES.items():
        before = {"overrides": [], **request}
        measure(case, before, {name: {**request, "overrides": way} for name, way in WAYS.items()})
    source = {"scenario": "sample_maneuver", "overrides": ["estimation.start=nominal"]}
    here.spent_s(**source, save=str(folder / "run"))
    record = {"record": str(folder / "run" / "telemetry.csv")}
    ways = {name: {**source, "overrides": [*source["overrides"], *way], **record} for name, way in RECORD.items()}
    measure("estimate", {**source, **record}, ways)
    return rows


def _line(row: dict[str, Any]) -> str:
    target = "" if row["target"] is None else f"{row['target']:6.1f}"
    spread = f"{row['least']:.2f} to {row['most']:.2f}"
    return (
        f"{row['case']:18} {row['way']:18} {row['ms']:8.1f} ms   {row['ratio']:6.2f} times ({spread})  target {target}"
    )


# -------------------------------------------------------------------------------- the joint filter


class _Timed:
    """Cycles of estimation whose processor time is measured one by one, see `runners.cycles.Cycles`."""

    def __init__(self, cycles: Any):
        self._cycles, self.spent_s = cycles, cycles.spent_s
        self.each_s: list[float] = []

    def __getattr__(self, name: str) -> Any:
        return getattr(self._cycles, name)

    def advance(self, until: int) -> None:
        began = time.process_time()
        try:
            self._cycles.advance(until)
        finally:
            self.each_s.append(time.process_time() - began)


def joint_cycles() -> list[dict[str, Any]]:
    """Measures mean and longest processor time of a cycle of the joint filter with its detector, ms."""
    from massprop_drake import load_scenario  # noqa: PLC0415
    from massprop_drake.runners.loop import Loop  # noqa: PLC0415

    rows = []
    for name in JOINT:
        for way in (LOOP, COMPILED_LOOP):
            scenario = load_scenario(name, WAYS[way])
            Loop(scenario).advance(1.0)  # compiles
            gc.collect()  # what the compiler has left behind is not of the flight
            run = Loop(scenario)
            run._cycles = timed = _Timed(run._cycles)  # type: ignore[assignment]
            run.advance(scenario.duration_s)
            each_ms = [1e3 * spent for spent in timed.each_s]
            rows.append({"case": name, "way": way, "mean": statistics.mean(each_ms), "longest": max(each_ms)})
            print(
                f"{name:18} {way:18} {rows[-1]['mean']:8.2f} ms a cycle   {max(each_ms):8.1f} at the most", flush=True
            )
    return rows


# -------------------------------------------------------------------------------------- campaigns


def campaign_cases() -> list[dict[str, Any]]:
    """Measures processor time of a campaign's case, compiled, with a new body each, ms: median and largest."""
    from massprop_drake.inputs.campaign_file import load_campaign  # noqa: PLC0415
    from massprop_drake.studies.campaign.campaign_flight import Flights  # noqa: PLC0415
    from massprop_drake.studies.campaign.plan import plan_cases  # noqa: PLC0415

    rows = []
    for base, (title, target) in CAMPAIGNS.items():
        overrides = [f"base={base}", "sweep={}", f"cases={CAMPAIGN_CASES + 1}", "execution.compiled=true"]
        campaign = load_campaign("healthy_maneuver", overrides)
        setup = {"base": campaign.base.model_dump(mode="json"), "campaign": "speed", "times_s": [], "keep": "none"}
        flights = Flights({**setup, "folder": "", "token": None})
        each_ms = []
        for case in plan_cases(campaign):
            began = time.process_time()
            flights.fly({**case._asdict(), "keep": False})
            each_ms.append(1e3 * (time.process_time() - began))
        each_ms = each_ms[1:]  # the first one compiles
        rows.append({"case": title, "median": statistics.median(each_ms), "most": max(each_ms), "target": target})
        print(f"{title:30} {rows[-1]['median']:8.0f} ms a case   {max(each_ms):8.0f} at the most", flush=True)
    return rows


# ---------------------------------------------------------------------------------------- scaling


def with_jets(count: int) -> list[str]:
    """Makes the orbiter with so many jets: copies of its own, slightly different from each other."""
    from massprop_drake import load_vehicle  # noqa: PLC0415

    data = load_vehicle("orbiter").model_dump(mode="json")
    own, made = data["jets"], []
    for number in range(count):
        jet = dict(own[number * 38 // min(count, 38) % 38 if count < 38 else number % len(own)])
        jet["designation"], jet["number"] = f"J{number}", number + 1
        jet["position"] = [x + 0.1 * (number // len(own)) for x in jet["position"]]
        jet["cluster"] = jet["cluster"] + 100 * (number // len(own))
        made.append(jet)
    return [f"vehicle.jets={json.dumps(made)}"]


def with_accelerometers(count: int) -> list[str]:
    """Makes the orbiter with so many accelerometers."""
    from massprop_drake import load_vehicle  # noqa: PLC0415

    data = load_vehicle("orbiter").model_dump(mode="json")
    own = data["accelerometers"]
    made = [{**own[number % len(own)], "name": f"acc{number + 1}"} for number in range(count)]
    return [
        f"vehicle.preferred_accelerometer={made[0]['name']}",
        f"vehicle.accelerometers={json.dumps(made)}",
    ]


def scaling(here: Version, repeats: int) -> dict[str, Any]:
    """Measures processor time per sample, microseconds, over jets, accelerometers and length."""
    found: dict[str, Any] = {}
    for title, values, made in (
        ("jets", JETS, with_jets),
        ("accelerometers", ACCELEROMETERS, with_accelerometers),
        ("length, s", LENGTHS_S, lambda length: [f"duration_s={length}"]),
    ):
        found[title] = {"values": list(values)}
        for name, way in WAYS.items():
            column = found[title][name] = []
            for value in values:
                overrides = [*made(value), *way]
                here.spent_s("sample_maneuver", overrides)
                spent = statistics.median(here.spent_s("sample_maneuver", overrides) for _ in range(repeats))
                column.append(1e6 * spent / ((value if title == "length, s" else 50.0) / 0.08))
            print(f"{title:16} {name:18} {' '.join(f'{number:8.0f}' for number in column)} us a sample", flush=True)
    return found


# --------------------------------------------------------------------------------------- the page


def write_page(
    folder: Path, against: str, rows: list[dict[str, Any]], tables: dict[str, str], grown: dict[str, Any]
) -> None:
    """Writes `speed.md` and its plots; ``tables``: rows of the other tables by their names in the template."""
    import matplotlib as mpl  # noqa: PLC0415 (slow to load)

    mpl.use("svg")
    from matplotlib import pyplot as plt  # noqa: PLC0415

    figure, axes = plt.subplots(figsize=(7, 0.45 * len(rows) + 1))
    names = [f"{row['case']}: {row['way']}" for row in rows]
    axes.barh(names, [row["ratio"] for row in rows], color="tab:blue")
    for place, row in enumerate(rows):
        axes.plot([row["least"], row["most"]], [place, place], color="black")
        if row["target"] is not None:
            axes.plot(row["target"], place, marker="|", markersize=16, color="tab:red")
    axes.invert_yaxis()
    axes.set_xlabel(f"times as fast as {against}; red: the target; black: spread")
    figure.tight_layout()
    (folder / "images").mkdir(parents=True, exist_ok=True)
    figure.savefig(folder / "images" / "speed.svg")
    if grown:
        figure, panels = plt.subplots(1, len(grown), figsize=(3.4 * len(grown), 3), sharey=True)
        for panel, (title, columns) in zip(panels, grown.items(), strict=True):
            for name in WAYS:
                panel.plot(columns["values"], columns[name], marker="o", label=name)
            panel.set_xlabel(title)
        panels[0].set_ylabel("processor time a sample, us")
        panels[0].legend(fontsize=7)
        figure.tight_layout()
        figure.savefig(folder / "images" / "speed_scaling.svg")
    table = "\n".join(f"| {row['case']} | {row['way']} | {row['ms']:.0f} | {row['ratio']:.2f} |" for row in rows)
    page = (REPOSITORY / "benchmarks" / "speed.md").read_text(encoding="utf-8")
    for name, text in {"against": against, "table": table, **tables}.items():
        page = page.replace(f"{{{name}}}", text)
    (folder / "speed.md").write_text(page, encoding="utf-8")


def _table(rows: list[dict[str, Any]], columns: tuple[str, ...]) -> str:
    """Formats rows of a table for the page."""

    def cell(value: Any) -> str:
        return f"{value:.3g}" if isinstance(value, float) else str(value)

    return "\n".join(f"| {' | '.join(cell(row[name]) for name in columns)} |" for row in rows)


def main() -> None:
    """Measures and prints."""
    if sys.argv[1:] == ["--serve"]:
        serve()
        return
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--against", metavar="COMMIT", default="HEAD")
    parser.add_argument("--repeats", type=int, default=5)
    parser.add_argument("--scaling", action="store_true")
    parser.add_argument("--write", type=Path)
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary)
        (folder / "there").mkdir()
        here, there = Version(REPOSITORY), Version(unpacked(arguments.against, folder / "there"))
        rows = compared(here, there, arguments.repeats, folder)
        there.close()
        grown = scaling(here, max(1, arguments.repeats // 2)) if arguments.scaling else {}
        here.close()
        joint, campaigns = joint_cycles(), campaign_cases()
        if arguments.write is not None:
            tables = {
                "load": f"{os.getloadavg()[2]:.1f}",
                "processors": str(os.cpu_count()),
                "joint": _table(joint, ("case", "way", "mean", "longest")),
                "campaigns": _table(campaigns, ("case", "median", "most", "target")),
            }
            write_page(arguments.write, arguments.against, rows, tables, grown)


if __name__ == "__main__":
    main()
