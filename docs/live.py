"""Follows a vehicle live: samples come over TCP, a JSON object a line, and each steps the estimator.

python docs/live.py VEHICLE HOST PORT [STATE_FILE]
"""

from __future__ import annotations

import json
import math
import socket
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from massprop_drake import Estimator, EstimatorStep, Vehicle, load_vehicle


# What comes in
def samples(host: str, port: int) -> Iterator[dict[str, Any]]:
    """Subscribes to a stream and yields its samples as they come, until the sender ends."""
    with socket.create_connection((host, port)) as connection, connection.makefile("rb") as stream:
        for line in stream:
            yield json.loads(line)


# What is made of it
def follow(stream: Iterator[dict[str, Any]], vehicle: Vehicle, estimator: Estimator) -> Iterator[EstimatorStep]:
    """Yields the estimator's step after each sample."""
    missing, unknown = np.full(3, np.nan), np.full(len(vehicle.jets), np.nan)
    last_s = math.nan
    for sample in stream:
        time_s = sample["time_s"]
        if time_s <= last_s:  # sent twice, or late: time must go forward
            continue
        if time_s - last_s > 1.5 * vehicle.sample_period_s:  # samples were lost
            after_s = last_s + vehicle.sample_period_s
            estimator.step(after_s, missing, missing, unknown)  # differences start anew
        commands = [sample["jets"].get(jet, 0.0) for jet in vehicle.designations]
        yield estimator.step(time_s, sample["gyro"], sample["accelerometer"], commands)
        last_s = time_s


# The program
def main(name: str, host: str, port: str, state: str = "") -> None:
    """Prints failures as they are declared, and the mass once it is known."""
    vehicle = load_vehicle(name)
    estimator = Estimator(vehicle)
    if state and Path(state).exists():  # go on from where an earlier run has ended
        estimator.restore(json.loads(Path(state).read_text(encoding="utf-8")))
    converged, step = False, None
    try:
        for step in follow(samples(host, int(port)), vehicle, estimator):
            if step.detection is not None:
                found = step.detection
                jets = " or ".join(found.jets)
                print(f"{step.time_s:.2f} s: {found.kind} {jets}, since {found.onset_s:.2f} s")
            if step.converged and not converged:
                print(f"{step.time_s:.2f} s: converged")
            converged = step.converged
    finally:
        if state:
            Path(state).write_text(json.dumps(estimator.state), encoding="utf-8")
    if step is not None:
        mass = 1.0 / step.estimate[9]
        sigma = mass**2 * step.standard_deviation[9]
        print(f"mass {mass:.4g} +- {sigma:.2g} {vehicle.unit_names['mass']}")


if __name__ == "__main__":
    main(*sys.argv[1:])
