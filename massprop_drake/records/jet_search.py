"""Search by the effects of jets on sensors: when commands act, their scale, and the meaning of readings."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from massprop_drake.inputs.record_map import RecordMap
from massprop_drake.inputs.units import si_factor
from massprop_drake.records import channels, evidence, mapping
from massprop_drake.records.command_search import CommandSearch

_OFF = 2.5  # factor by which the true rates may differ from those predicted with the nominal mass properties
_DISFAVOR = 0.1  # of the log of a factor, by which a likelier scale may fit worse
_RATE_UNITS = (*mapping.RATE_UNITS, "deg/h")  # that are farther apart than the true rates may be
_FARTHEST = 20  # intervals that commands may be logged early or late: a budget of time


class JetSearch(CommandSearch):
    """Search by the jets' effects: when commands act, their scale, and the meaning of readings."""

    def search_by_jets(self) -> None:
        """Sets in the map when commands act, their scale, and the meaning of readings, by the jets' effects."""
        if "commands" not in self.data or not self.data["sensors"]:
            return
        commands, rule = self.data["commands"], "a row's command acts from the row on"
        commands["acts"] = "from_row"
        inertial = [name for name, one in self.data["sensors"].items() if one["kind"] in ("gyro", "accelerometer")]
        records = {acts: self._apply_map_so_far(acts) for acts in ("from_row", "until_row")}
        until_row, from_row = records["until_row"], records["from_row"]
        gyro = next((name for name in inertial if self.data["sensors"][name]["kind"] == "gyro"), "")
        if not gyro or until_row is None or from_row is None:
            self._say(f"commands.acts: from_row, since nothing here tells: {rule}")
            return
        both = [evidence.compare_with_jet_effects(one, gyro) for one in (from_row, until_row)]
        if any(math.isnan(one.correlation) for one in both):
            self._say("commands.acts: from_row, since too few jets fire to tell")
            record = from_row
        else:
            later = both[1].related > both[0].related + evidence.ODDS
            commands["acts"] = "until_row" if later else "from_row"
            record = until_row if later else from_row
            self._say(
                f"commands.acts: {commands['acts']}, since the rates follow a row's command with a correlation of "
                f"{both[0].relation:.2f} in the interval after the row and {both[1].relation:.2f} in the one before"
            )
            self._warn_of_lag(record.channels[gyro], both[0], both[later])
            self._choose_scale(gyro, both[later], float(np.median(np.diff(record.commands.begin_s))))
        for name in inertial:
            if self.data["sensors"][name]["kind"] == "accelerometer":
                self._choose_meaning(name, record)

    def _warn_of_lag(
        self, gyro: channels.Channel, unlagged: evidence.JetEvidence, chosen: evidence.JetEvidence
    ) -> None:
        """Warns where rates fit commands better at another lag of whole rows than at the chosen one."""
        farthest = min(_FARTHEST, len(unlagged.meant) // 2)
        lags = {lag: unlagged.shifted(lag) for lag in range(-farthest, farthest + 1)}
        best = max(lags, key=lambda lag: np.nan_to_num(lags[lag].related))
        odds = evidence.ODDS + math.log(len(lags))  # any of them may be the one
        if lags[best].related > chosen.related + odds and not lags[best].is_poor:
            rows = f"{abs(best)} row{'s' if abs(best) > 1 else ''} {'after' if best > 0 else 'before'}"
            offset_s = float(f"{best * gyro.interval_s:.9g}")
            self._warn(
                f"{gyro.name}: the rates follow commands best, with a correlation of {lags[best].relation:.2f}, that "
                f"act from {rows} their own on, which neither interval next to a row is: give these a clock of their "
                f"own, `commands: {{acts: from_row, time: {{..., offset_s: {offset_s:g}}}}}`"
            )
        else:
            self._warn_of_misfit(gyro.name, "rates", chosen)

    def _warn_of_misfit(self, name: str, noun: str, match: evidence.JetEvidence) -> None:
        """Warns of a sensor whose readings the jets' effects do not explain, or that oppose them."""
        if misfit := evidence.describe_misfit(name, noun, match):
            self._warn(misfit)

    def _apply_map_so_far(self, timing: str) -> channels.Mapped | None:
        """Applies the unfinished map, with commands `from_row` or `until_row`; None where it cannot be applied."""
        try:
            applied = RecordMap.model_validate({**self.data, "commands": {**self.data["commands"], "acts": timing}})
            return mapping.apply_map(self.recording, applied, self.vehicle, limits=False)
        except ValueError:  # said when the map is shown
            return None

    def _choose_scale(self, gyro: str, match: evidence.JetEvidence, interval_s: float) -> None:
        """Chooses the scale of commands, and a guessed unit of rates, by how fast the jets turn the vehicle.

        One of both may change, the unit only where the scale is sure; the likelier scale may fit a little worse.
        Commands are logged an interval apart, s.
        """
        if not match.related > evidence.ODDS or not match.gain > 0.0:
            return
        entry = self.data["sensors"][gyro]
        full = [_full_scale(one, interval_s) for one in self._scales] or [1.0]
        units = _RATE_UNITS if gyro in self._guessed and self._is_scale_sure else (entry["unit"],)

        def misfit(scale: int, unit: str) -> float:
            """Computes the absolute log ratio of measured to predicted change, with this scale and unit."""
            times = full[scale] / full[0] * si_factor(unit, "rate") / si_factor(entry["unit"], "rate")
            return abs(math.log(match.gain * times))

        scale, unit = min(
            ((index, unit) for index in range(len(full)) for unit in units if not index or unit == entry["unit"]),
            key=lambda one: misfit(*one) + _DISFAVOR * (one[0] + (one[1] != entry["unit"])),
        )
        if misfit(scale, unit) > math.log(_OFF):
            self._warn(
                f"{gyro}: the rates change {match.gain:.3g} times as much as the jets should make them, as units and "
                "commands are taken: look there first"
            )
            return
        if unit != entry["unit"]:
            self._say(
                f"{gyro}: {unit}, since as {entry['unit']} it would turn {match.gain:.3g} times as much as the jets "
                "can make it"
            )
            entry["unit"] = unit
        if scale:
            for key in ("unit", "on"):
                self.data["commands"].pop(key, None)
            self.data["commands"] |= self._scales[scale]
            text = ", ".join(f"{key} {value}" for key, value in self._scales[scale].items()) or "fractions"
            self._say(
                f"commands: {text}, since else the rates would change {match.gain:.3g} times as much as the jets can "
                "make them"
            )

    def _choose_meaning(self, name: str, record: channels.Mapped) -> None:
        """Sets whether an accelerometer gives integrals, increments or means, by the jets' effects on it."""
        entry = self.data["sensors"][name]
        if entry["gives"] in ("mean", "instant") and name not in self._guessed:  # their unit is that of an acceleration
            self._report_correlation(name, evidence.compare_with_jet_effects(record, name))
            return
        sums, values = (
            evidence.compare_with_jet_effects(record, name, gives=gives) for gives in ("integral", "increment")
        )
        gives, matching = entry["gives"], ""
        if sums.related > values.related + evidence.ODDS:
            gives, matching = "integral", "differences"
        elif values.related > sums.related + evidence.ODDS:
            gives, matching = self._increment_or_mean(name, record, values), "values"
        elif gives == "increment" and not values.related > evidence.ODDS and evidence.keeps_its_level(record, name):
            gives = "integral"
        match = sums if gives == "integral" else values
        if gives == entry["gives"]:
            self._report_correlation(name, match)
            return
        self._warn_of_misfit(name, "readings", match)
        entry["gives"] = gives
        if not matching:
            self._say(f"{name}: sums of increments, since they keep their level while no jet fires")
            return
        if name in self._guessed:
            entry["unit"] = f"{self._guessed[name]}^2" if gives == "mean" else self._guessed[name]
        names = {"integral": "sums of increments", "increment": "increments of velocity", "mean": "accelerations"}
        self._say(
            f"{name}: {names[gives]}, since their {matching} follow the commands with a correlation of "
            f"{max(sums.relation, values.relation):.2f}, their "
            f"{'values' if matching == 'differences' else 'differences'} with "
            f"{min(sums.relation, values.relation):.2f}"
        )

    def _report_correlation(self, name: str, match: evidence.JetEvidence) -> None:
        """Reports the correlation of an accelerometer's readings with the commands, or warns of a misfit."""
        sentences, doubted = evidence.describe_response(name, "readings", match)
        for sentence in sentences:
            self._say(sentence)
        for sentence in doubted:
            self._warn(sentence)

    def _increment_or_mean(self, name: str, record: channels.Mapped, values: evidence.JetEvidence) -> str:
        """Returns "increment" or "mean", whichever fits the size of changes that the jets should cause."""
        stated = "mean" if self.data["sensors"][name]["gives"] == "mean" else "increment"
        if name not in self._guessed:
            return stated
        misfit = {"increment": abs(math.log(values.gain))}
        misfit["mean"] = abs(math.log(evidence.compare_with_jet_effects(record, name, gives="mean").gain))
        misfit[stated] -= _DISFAVOR
        return min(misfit, key=lambda gives: misfit[gives])


def _full_scale(scale: Mapping[str, Any], interval_s: float) -> float:
    """Returns the number in the record that stands for a jet open over the whole interval of a row."""
    unit = scale.get("unit", "1")
    if unit == "%":
        return 100.0
    return float(scale.get("on", 1.0)) if unit == "1" else interval_s / si_factor(unit, "time")
