"""Cost of a campaign besides its cases: CPU time of two workers against one, and the driver's memory.

    python benchmarks/campaign.py [--flights 60] [--cases 10000]

The first flies whole sample maneuvers with one worker and with two, and compares CPU time a case; wall time is shown
beside it. The second flies cases of one sample each and looks at this process, in which Dask's scheduler runs as well.
"""

from __future__ import annotations

import argparse
import resource
import tempfile
import time
from pathlib import Path

import psutil

from massprop_drake.studies.campaign.campaign import Campaign

STUDY = """
name: benchmark
base: sample_maneuver
cases: {cases}
keep: none
set: {{duration_s: {duration_s}}}
draw:
  plant.mass_properties: {{mass_percent: 5, center_of_mass: 0.3, second_moments_percent: 3, axes_deg: 1}}
  failures: [{{kind: {{choice: [stuck_on, leak]}}, jet: {{choice: all}}, start_s: 0.05, force: 5}}]
"""


def campaign(folder: Path, cases: int, duration_s: float) -> Campaign:
    """Makes the campaign of some cases."""
    path = folder / "benchmark.yaml"
    path.write_text(STUDY.format(cases=cases, duration_s=duration_s))
    return Campaign.load(path)


def efficiency(folder: Path, cases: int) -> None:
    """Prints CPU time a case with one worker and with two."""
    spent = {}
    for workers in (1, 2):
        began = time.perf_counter()
        table = campaign(folder, cases, 50.0).run(folder / f"by-{workers}", workers=workers).to_pandas()
        wall = time.perf_counter() - began
        cpu = table["cpu_s"]
        spent[workers] = cpu.mean(), cpu.median()  # each child's first case loads more, which the median leaves out
        words = f"{cpu.mean():.3f} s of CPU a case (median {cpu.median():.3f} s), {wall / cases:.3f} s of wall time"
        print(f"{workers} workers: {words}", flush=True)
    mean, median = (alone / shared for alone, shared in zip(spent[1], spent[2], strict=True))
    print(f"efficiency of 2 workers against 1, by CPU time: {mean:.2f}, by its median {median:.2f}")


def memory(folder: Path, cases: int) -> None:
    """Prints this process's memory while many cases are flown."""
    own = psutil.Process()
    began = time.perf_counter()
    study = campaign(folder, cases, 0.08)
    sizes: dict[int, float] = {}

    def look(done: int, _: int) -> None:
        sizes[done] = own.memory_info().rss / 1e6

    before = own.cpu_times()
    study.run(folder / "many", progress=look)
    after = own.cpu_times()
    cpu = after.user + after.system - before.user - before.system
    print(
        f"{cases} cases in {time.perf_counter() - began:.0f} s, {1e3 * cpu / cases:.1f} ms a case of the driver's CPU"
    )
    at = {part: sizes[min(done for done in sizes if done >= part * cases)] for part in (0.1, 0.5, 1.0)}
    print("memory of the driver: " + ", ".join(f"{size:.0f} MB at {part:.0%}" for part, size in at.items()), end="; ")
    print(f"{resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024 / 1e6:.0f} MB at the most, from the plan on")


def main() -> None:
    """Measures efficiency and memory."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--flights", type=int, default=60)
    parser.add_argument("--cases", type=int, default=10_000)
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        if arguments.flights:
            efficiency(Path(folder), arguments.flights)
        if arguments.cases:
            memory(Path(folder), arguments.cases)


if __name__ == "__main__":
    main()
