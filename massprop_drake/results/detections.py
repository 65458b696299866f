"""Failures and jumps as they were declared, one record each, read from a run's signals."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from massprop_drake.inputs.model import Count, NotNegative, Real, Text, Whole
from massprop_drake.inputs.vehicle import Vehicle
from massprop_drake.maths.estimation.detector import STATUS, Event
from massprop_drake.maths.estimation.detectors.hypotheses import HYPOTHESIS_REPORT
from massprop_drake.maths.estimation.detectors.multi_hypothesis import Word

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
        isolated_to: "jet", "group" (one of `jets`, which the data cannot tell apart) or "cluster"; None for a jump.
        magnitude: force too much (positive) or missing (negative), lbf or N; None for a jump.
        magnitude_std: its 1-sigma, lbf or N.
        statistic: likelihood argument of the failure; of a jump the NIS of the sample.
        alarms: how many alarms led to the declaration.
        withdrawn_s: when the declaration was withdrawn, s; None while it stands.
        jets: designations of the jets that it may be, the likeliest first; none where only a cluster is named.
        mass, mass_std: gained in a jump (released: negative), slug or kg, and its 1-sigma, as measured once the filter
            has settled after it; None where the method measures none.
        jet_index: index of the likeliest jet of the vehicle, while the run goes on; None for a jump, and in a
            summary.
    """

    onset_s: Real
    time_s: Real
    kind: Kind
    cluster: Whole | None
    jet: Text | None
    isolated_to: Literal["jet", "group", "cluster"] | None
    magnitude: Real | None
    magnitude_std: NotNegative | None
    statistic: Real
    alarms: Count
    withdrawn_s: Real | None = None
    jets: tuple[Text, ...] = ()
    mass: Real | None = None
    mass_std: NotNegative | None = None
    jet_index: Count | None = None

    @property
    def suspects(self) -> str:
        """The jet that it is about, or those that it may be, in words."""
        if self.isolated_to == "group":
            return f"one of {', '.join(self.jets)}"
        return f"jet {self.jet}" if self.jet else f"a jet of cluster {self.cluster}"


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
        now_s, event = float(time_s[k]), int(at["detector_event"])
        if "verdict" in signals:
            row = {name: signals[name][k] for name in _OF_HYPOTHESES}
            records = _told(vehicle, now_s, (at, row), records)
            continue
        jet = int(at["suspected_jet"])
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
        jets=(vehicle.designations[jet],) if isolated else (),
        jet_index=jet,
    )


_OF_HYPOTHESES = tuple(HYPOTHESIS_REPORT)
_SIGNIFICANT = 3.0  # sigmas of a mass that is told before it has been measured


def _told(
    vehicle: Vehicle,
    time_s: float,
    told: tuple[Mapping[str, float], Mapping[str, Array]],
    earlier: list[DetectionRecord],
) -> list[DetectionRecord]:
    """The records after what the detector by hypotheses says at a sample.

    Args:
        vehicle: for its jets.
        time_s: of the sample.
        told: what all detectors log of it, and what this one logs besides.
        earlier: records before it.
    """
    at, row = told
    records = list(earlier)
    verdict = row["verdict"]
    group = sorted(np.flatnonzero(verdict == Word.GROUP).tolist(), key=lambda jet: jet != at["suspected_jet"])
    alone = [[jet] for jet in np.flatnonzero(verdict == Word.FAILED).tolist()]
    for jets in ([group] if group else []) + alone:
        jet = jets[0]
        magnitude, std = float(row["verdict_magnitude"][jet]), float(row["verdict_std"][jet])
        names = tuple(vehicle.designations[each] for each in jets)
        records.append(
            DetectionRecord(
                onset_s=float(row["verdict_onset"][jet]),
                time_s=time_s,
                kind=_kind(magnitude, std, vehicle.jets[jet].thrust),
                cluster=vehicle.jets[jet].cluster,
                jet=None if group and jets is group else names[0],
                isolated_to="group" if group and jets is group else "jet",
                magnitude=magnitude,
                magnitude_std=std,
                statistic=at["suspected_likelihood"],
                alarms=int(at["alarms"]),
                jets=names,
                jet_index=jet,
            )
        )
    for jet in np.flatnonzero(verdict == Word.WITHDRAWN).tolist():
        records = [
            record._replace(withdrawn_s=time_s) if record.jet_index == jet and record.withdrawn_s is None else record
            for record in records
        ]
    if not np.isnan(row["jump_mass"][0]):
        mass, std = float(row["jump_mass"][0]), float(row["jump_mass_std"][0])
        jumps = [index for index, record in enumerate(records) if record.kind == JUMP]
        if not row["jump_measured"][0]:
            found = _jump(time_s, at, at["suspected_likelihood"])
            known = abs(mass) > _SIGNIFICANT * std
            records.append(found._replace(mass=mass, mass_std=std) if known else found)
        elif jumps:
            records[jumps[-1]] = records[jumps[-1]]._replace(mass=mass, mass_std=std)
    return records


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
