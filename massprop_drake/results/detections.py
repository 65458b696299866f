"""Failures and jumps as they were declared, one record each, read from a run's signals."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from massprop_drake.inputs.model import Count, NotNegative, Real, Text, Whole
from massprop_drake.inputs.vehicle import Vehicle
from massprop_drake.maths.estimation.detector import STATUS, Event

Array = NDArray[np.float64]

Kind = Literal["jet_on", "jet_off", "jet_degraded", "mass_property_jump"]
JUMP: Kind = "mass_property_jump"


class DetectionRecord(NamedTuple):
    """A failed jet, or a jump of the mass properties, as it was declared and what became of it since.

    Attributes:
        onset_s: best estimate of when it began, s.
        time_s: when it was declared, s.
        kind: "jet_on" (stuck on or leaking), "jet_off", "jet_degraded" or "mass_property_jump".
        cluster: number of the suspected jet's cluster; None for a jump.
        jet: designation of the jet; None for a jump, and where the data name no more than its cluster.
        isolated_to: "jet" or "cluster"; None for a jump.
        magnitude: force too much (positive) or missing (negative), lbf or N; None for a jump.
        magnitude_std: its 1-sigma, lbf or N.
        statistic: likelihood argument of the failure; of a jump the NIS of the sample.
        alarms: how many alarms led to the declaration.
        withdrawn_s: when the declaration was withdrawn, s; None while it stands.
        jet_index: index of the likeliest jet of the vehicle, while the run goes on; None for a jump, and in a
            summary.
    """

    onset_s: Real
    time_s: Real
    kind: Kind
    cluster: Whole | None
    jet: Text | None
    isolated_to: Literal["jet", "cluster"] | None
    magnitude: Real | None
    magnitude_std: NotNegative | None
    statistic: Real
    alarms: Count
    withdrawn_s: Real | None = None
    jet_index: Count | None = None


def detection_entries(
    vehicle: Vehicle, time_s: Array, signals: Mapping[str, Array], earlier: Sequence[DetectionRecord] = ()
) -> list[DetectionRecord]:
    """Lists declared failures and jumps, one record each, as they were declared.

    Args:
        vehicle: for its jets.
        time_s: sample times, s, shape (n,).
        signals: by name, shape (n, components).
        earlier: records from before these samples, some of which may be withdrawn now.
    """
    records = list(earlier)
    if "detector_event" not in signals:
        return records
    for k in np.flatnonzero(signals["detector_event"][:, 0]):
        at = {name: float(signals[name][k, 0]) for name in STATUS}
        now_s, jet, event = float(time_s[k]), int(at["suspected_jet"]), int(at["detector_event"])
        if event == Event.WITHDRAWN:
            records = [
                record._replace(withdrawn_s=now_s) if record.jet_index == jet and record.withdrawn_s is None else record
                for record in records
            ]
        elif event == Event.DECLARED:
            records.append(_declared(vehicle, now_s, jet, at))
        else:
            records.append(_jump(now_s, at, float(signals["rotation_nis"][k, 0])))
    return records


def settled(records: Sequence[DetectionRecord], force: Array, variance: Array) -> tuple[DetectionRecord, ...]:
    """Brings detections to the end of a run: a force that has been followed since is given as it is known now.

    Args:
        records: as `detection_entries` gives them.
        force, variance: known force of each jet at the end, lbf or N, and its variance, shape (n_jets,).
    """

    def at_the_end(record: DetectionRecord) -> DetectionRecord:
        jet = record.jet_index
        if record.kind == "jet_on" and jet is not None and variance[jet] > 0.0:
            record = record._replace(magnitude=float(force[jet]), magnitude_std=float(np.sqrt(variance[jet])))
        return record._replace(jet_index=None)

    return tuple(map(at_the_end, records))


def _declared(vehicle: Vehicle, time_s: float, jet: int, at: Mapping[str, float]) -> DetectionRecord:
    magnitude, std = at["suspected_magnitude"], at["suspected_magnitude_std"]
    isolated = bool(at["jet_isolated"])
    return DetectionRecord(
        onset_s=at["onset"],
        time_s=time_s,
        kind=_kind(magnitude, std, vehicle.jets[jet].thrust),
        cluster=vehicle.jets[jet].cluster,
        jet=vehicle.designations[jet] if isolated else None,
        isolated_to="jet" if isolated else "cluster",
        magnitude=magnitude,
        magnitude_std=std,
        statistic=at["suspected_likelihood"],
        alarms=int(at["alarms"]),
        jet_index=jet,
    )


def _jump(time_s: float, at: Mapping[str, float], nis: float) -> DetectionRecord:
    return DetectionRecord(
        onset_s=at["onset"],
        time_s=time_s,
        kind="mass_property_jump",
        cluster=None,
        jet=None,
        isolated_to=None,
        magnitude=None,
        magnitude_std=None,
        statistic=nis,
        alarms=int(at["alarms"]),
    )


def _kind(magnitude: float, std: float, thrust: float) -> Kind:
    if magnitude > 0.0:
        return "jet_on"
    lost_all = -magnitude > 0.9 * thrust or abs(magnitude + thrust) < 3.0 * std
    return "jet_off" if lost_all else "jet_degraded"
