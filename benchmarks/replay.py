"""Speed and memory of estimating from recorded telemetry, with the orbiter's 44 jets and the failure detector.

    python benchmarks/replay.py [ROWS ...]        default 100000 200000 1000000

The record is a simulated maneuver told over and over, each time a little later, with a gap between. Each
length is read in a process of its own, and its peak memory is that of the process. Saving the run's folder
counts as well, with figures.
"""

from __future__ import annotations

import json
import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from massprop_drake import load_scenario, simulate

_SCENARIO, _OVERRIDES = "sample_maneuver", ["duration_s=60", "estimation.start=nominal"]
_PAUSE_S = 0.24  # between two repetitions


def write_record(path: Path, rows: int) -> None:
    """Writes telemetry of some number of rows."""
    with tempfile.TemporaryDirectory() as folder:
        run = simulate(load_scenario(_SCENARIO, _OVERRIDES))
        run.save(Path(folder) / "run", pictures=False)
        heading, *lines = (Path(folder) / "run" / "telemetry.csv").read_text(encoding="utf-8").splitlines()
    cells = [line.split(",", 1) for line in lines]
    step_s = float(cells[-1][0]) + _PAUSE_S
    with path.open("w", encoding="utf-8") as file:
        file.write(heading + "\n")
        for index in range(rows):
            repetition, row = divmod(index, len(cells))
            file.write(f"{repetition * step_s + float(cells[row][0]):.10g},{cells[row][1]}\n")


def measure(path: Path) -> None:
    """Estimates from a record and prints the figures as JSON; run in a process of its own."""
    from massprop_drake import estimate  # noqa: PLC0415 (its memory is measured)

    with tempfile.TemporaryDirectory(dir=path.parent) as folder:
        began = time.perf_counter()
        run = estimate(path, load_scenario(_SCENARIO, _OVERRIDES), folder=path.parent)
        estimated_s = time.perf_counter() - began
        after = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
        run.save(Path(folder) / "run")
        saved_s = time.perf_counter() - began - estimated_s
        size = sum(file.stat().st_size for file in (Path(folder) / "run").rglob("*") if file.is_file())
    found = {
        "rows": run.summary["data_quality"]["rows"],
        "estimating_s": estimated_s,
        "saving_s": saved_s,
        "peak_estimating_mb": after / 1024.0,
        "peak_mb": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0,
        "folder_mb": size / 1e6,
    }
    print(json.dumps(found))


def main() -> None:
    """Measures each length and prints a line for it."""
    if sys.argv[1:2] == ["--measure"]:
        measure(Path(sys.argv[2]))
        return
    print(f"{'rows':>9}  {'rows/s':>7}  {'with saving':>11}  {'peak, MB':>8}  {'with saving':>11}  {'folder, MB':>10}")
    for rows in [int(argument) for argument in sys.argv[1:]] or [100_000, 200_000, 1_000_000]:
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / "record.csv"
            write_record(path, rows)
            command = [sys.executable, __file__, "--measure", str(path)]
            done = subprocess.run(command, check=True, capture_output=True, text=True)
        found = json.loads(done.stdout)
        both = found["rows"] / (found["estimating_s"] + found["saving_s"])
        print(
            f"{found['rows']:9d}  {found['rows'] / found['estimating_s']:7.0f}  {both:11.0f}  "
            f"{found['peak_estimating_mb']:8.0f}  {found['peak_mb']:11.0f}  {found['folder_mb']:10.0f}",
            flush=True,
        )


if __name__ == "__main__":
    main()
