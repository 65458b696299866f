"""Findings of a flight so far: failed jets, detections and the verdict on the filters."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Protocol

from pydrake.common.value import Value
from pydrake.systems.framework import EventStatus, LeafSystem

from massprop_drake.maths.linear_algebra import Array
from massprop_drake.systems.caching import NOTHING, declare_output


class Monitor(Protocol):
    """Functions that make findings of reports, such as `results.monitoring.FlightMonitor`.

    Attributes:
        counts: at the start, a vector that changes at every sample.
        declarations: at the start, a value that changes where a detector says something.
    """

    counts: Array
    declarations: Any

    def has_event(self, detector_report: Array) -> bool:
        """Tests whether a detector's report of a sample declares something."""

    def count_innovations(self, counts: Array, time_s: float, reports: Mapping[str, Array]) -> Array:
        """Returns the counts of innovations, a vector, with those of a sample's reports added."""

    def update_declarations(
        self, declared_before: Any, counts: Array, time_s: float, reports: Mapping[str, Array]
    ) -> Any:
        """Computes the value of findings after a sample at which a detector declares something."""

    def detections(self, declared: Any, counts: Array) -> tuple[Any, ...]:
        """Returns the detections so far."""

    def failed_jets(self, declared: Any) -> Array:
        """Flags failed jets by the findings so far, shape (n_jets,)."""

    def verdict(self, counts: Array) -> Any:
        """Returns the verdict on the flight by the findings so far."""


class FindingsMonitor(LeafSystem):
    """Follows the reports of filters and detector, so that an autopilot can act on their findings.

    Ports:
        rotation_report (in, 28), mass_report (in, 11), joint_report (in, 3), detector_report (in, 14 + 4 n_jets),
            hypothesis_report (in, 21 + 12 n_jets): those that the estimators have. Required.
        failed_jets (out, n_jets): 1 for each jet that a standing declaration names, alone or among those that the data
            cannot tell from it. No feedthrough.
        detections (out, abstract): a tuple of `results.detections.DetectionRecord`, as `summary.json` has them at the
            end, with sizes as they are known now. No feedthrough.
        verdict (out, abstract): `results.consistency.Consistency` by the innovations so far. No feedthrough.

    State: the monitor's `counts` of the innovations so far, with mass and known forces at the last sample; abstract,
    events and detections so far, never changed: an event makes new ones.

    Timing: outputs at t_k are of the samples before t_k, so that a command that depends on them closes no loop; after
    the update at t_k they are of that sample, too. Nothing is made for an output that nobody reads.

    Args:
        monitor: functions that make findings.
        reports: size of each report, by its port.
        period_s: sample period, s.
    """

    is_resumed = False  # a run that goes on from another one begins it anew

    def __init__(self, monitor: Monitor, *, reports: Mapping[str, int], period_s: float):
        super().__init__()
        self.set_name("findings_monitor")
        self._monitor = monitor
        self._reports = {name: self.DeclareVectorInputPort(name, size) for name, size in reports.items()}
        self._counts = self.DeclareDiscreteState(monitor.counts)
        self._findings = self.DeclareAbstractState(Value[object](monitor.declarations))
        said = {self.xa_ticket()}
        n_jets = monitor.failed_jets(monitor.declarations).size
        declare_output(self, "failed_jets", n_jets, lambda now: monitor.failed_jets(self._read_findings(now)), said)
        for name, calc, read in (
            ("detections", self._calc_detections, {*said, self.xd_ticket()}),
            ("verdict", self._calc_verdict, {self.xd_ticket()}),
        ):
            self.DeclareAbstractOutputPort(
                name, alloc=lambda: Value[object](NOTHING), calc=calc, prerequisites_of_calc=read
            )
        when = {"period_sec": period_s, "offset_sec": 0.0}
        self.DeclarePeriodicDiscreteUpdateEvent(**when, update=self._update)
        if "detector_report" in reports:
            self.DeclarePeriodicUnrestrictedUpdateEvent(**when, update=self._update_findings)

    def _read_counts(self, context: Any) -> Array:
        """Returns the innovation counts so far from the context."""
        counts: Array = context.get_discrete_state(self._counts).CopyToVector()
        return counts

    def _read_findings(self, context: Any) -> Any:
        """Returns events and detections so far from the context."""
        return context.get_abstract_state(self._findings).get_value()

    def _read_reports(self, context: Any) -> dict[str, Array]:
        """Returns the reports of filters and detector at the input ports, by name."""
        return {name: port.Eval(context) for name, port in self._reports.items()}

    def _calc_detections(self, context: Any, output: Any) -> None:
        """Writes the detections so far into the output."""
        output.set_value(self._monitor.detections(self._read_findings(context), self._read_counts(context)))

    def _calc_verdict(self, context: Any, output: Any) -> None:
        """Writes the consistency verdict so far into the output."""
        output.set_value(self._monitor.verdict(self._read_counts(context)))

    def _update(self, context: Any, state: Any) -> None:
        """Adds the sample's innovations to the counts."""
        counts = self._monitor.count_innovations(
            self._read_counts(context), context.get_time(), self._read_reports(context)
        )
        state.set_value(self._counts, counts)

    def _update_findings(self, context: Any, state: Any) -> EventStatus:
        """Writes new findings into the abstract state where the detector declares something."""
        # where nothing is said nothing has changed: all that has been evaluated at this time stays valid
        if not self._monitor.has_event(self._reports["detector_report"].Eval(context)):
            return EventStatus.DidNothing()
        arguments = self._read_counts(context), context.get_time(), self._read_reports(context)
        findings = self._monitor.update_declarations(self._read_findings(context), *arguments)
        state.get_mutable_abstract_state(self._findings).set_value(findings)
        return EventStatus.Succeeded()
