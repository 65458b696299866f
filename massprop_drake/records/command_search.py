"""Search for commands among columns, and for the scale of their numbers."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from massprop_drake.maths.linear_algebra import Array
from massprop_drake.records import mapping
from massprop_drake.records.command_scales import CommandScale, Levels, drop_rare_commands, possible_scales, two_levels
from massprop_drake.records.map_search import MapSearch
from massprop_drake.records.names import JetColumns, jet_families, read_name, si_factor_or_none
from massprop_drake.records.topics import Topic

_PULSES = (500.0, 2600.0)  # us, between which widths of pulses lie
_CLOSED_PULSE = 950.0  # us, below which a width means disarmed


class CommandSearch(MapSearch):
    """Search for commands, and for the scale of their numbers."""

    def _families(self, topic: Topic) -> list[JetColumns]:
        """Lists groups of a topic's columns with one column per jet, the likelier to be commands first."""
        numeric = [column for column, values in topic.columns.items() if values.dtype != object]
        return jet_families(numeric, [(jet.designation, jet.number) for jet in self.vehicle.jets])

    def _jet_columns(self, topic: Topic) -> dict[str, str]:
        """Maps each jet's designation to its command column in a topic; empty where any jet lacks one."""
        family = self._jet_family(topic)
        return {} if family is None else family.columns

    def _switched_columns(self, topic: Topic) -> set[str]:
        """Returns the jets' columns in a topic if their values switch as commands do; else an empty set."""
        columns = self._jet_columns(topic).values()
        return set(columns) if columns and self._are_command_values(topic, [*columns]) else set()

    def _jet_family(self, topic: Topic) -> JetColumns | None:
        """Returns the likeliest group of a topic's columns with one for each jet; None where there is none."""
        for family in self._families(topic):
            columns = list(family.columns.values())
            if family.lacking or (not family.named and not self._are_command_values(topic, columns)):
                continue
            if any(_varies(topic.numbers(column)) for column in family.beside):
                self.partial_commands = (
                    f"; {', '.join([*columns, *family.beside])} are more than the vehicle's {len(columns)} jets"
                )
                continue
            return family
        return None

    def _find_commands(self, topic: Topic) -> bool:
        """Adds a topic's jet commands to the map (columns, list or bit mask); returns whether there are any."""
        family = self._jet_family(topic)
        if family is not None:
            self.data["commands"] = {"columns": family.columns}
            why = "by their names" if family.named else "by their numbers, and since they switch as valves do: a guess"
            self._say(f"commands: a column for each of the {len(family.columns)} jets, {why}")
            self._find_scale(topic, family.columns)
            return True
        families = self._families(topic)
        part = next((one for one in families if one.named and 2 * len(one.columns) > len(self.vehicle.jets)), None)
        if part is not None and part.lacking:
            self.partial_commands = (
                f"; {', '.join(part.columns.values())} look like them, but there is none for jet "
                f"{', '.join(part.lacking)}"
            )
        for column, values in topic.columns.items():
            if values.dtype == object:
                texts = {word.lower() for text in topic.texts(column) for word in mapping.split_jet_list(text)}
                if texts and texts <= {jet.lower() for jet in self.vehicle.designations}:
                    self.data["commands"] = {"listed": {"column": column}}
                    self._say(f"commands: column {column} lists designations of jets, such as {sorted(texts)[0]}")
                    return True
        jet_columns = {column for one in families if one.named for column in (*one.columns.values(), *one.beside)}
        for column, values in topic.columns.items():
            if values.dtype == object or column in jet_columns or not read_name(column).may_be_mask:
                continue
            numbers = topic.numbers(column)
            numbers = numbers[np.isfinite(numbers)]
            whole = numbers.size and (numbers == np.round(numbers)).all() and numbers.min() >= 0.0
            if whole and 1.0 < numbers.max() < 2.0 ** len(self.vehicle.jets):
                bits = {jet: bit for bit, jet in enumerate(self.vehicle.designations)}
                self.data["commands"] = {"mask": {"column": column, "bits": bits}}
                self._say(
                    f"commands: column {column} has whole numbers below 2^{len(bits)}: a bit mask; that bit 0 is "
                    f"{self.vehicle.designations[0]} and so on is a guess"
                )
                return True
        return False

    def _are_command_values(self, topic: Topic, columns: Sequence[str]) -> bool:
        """Tests whether columns, whatever their names, hold two levels or pulse widths, as commands do."""
        values = np.concatenate([topic.numbers(column) for column in columns])
        values = values[np.isfinite(values)]
        if not _varies(values):
            return False
        return bool(values.min() > _PULSES[0] and values.max() < _PULSES[1]) or two_levels(values) is not None

    def _find_scale(self, topic: Topic, columns: Mapping[str, str]) -> None:
        """Finds scales that the jets' command columns may have, and writes the likeliest one into the map."""
        values = np.concatenate([topic.numbers(column) for column in columns.values()])
        values = values[np.isfinite(values)]
        name = read_name(next(iter(columns.values())), topic.units.get(next(iter(columns.values())), ""))
        if not values.size:
            return
        is_timed = name.is_on_time or si_factor_or_none(name.unit, "time") is not None
        is_told = is_timed or si_factor_or_none(name.unit, "number") is not None
        levels = two_levels(values)
        if levels is not None and not is_told and (levels.closed != 0.0 or levels.scatters):
            self._take_levels(levels)
            return
        if np.isin(values, (0.0, 1.0)).all() and not is_timed:
            return
        if values.min() > _PULSES[0] and values.max() < _PULSES[1]:
            off, on = _pulse_widths(values)
            self.data["commands"] |= {"off": off, "on": on}
            self._say(
                f"commands: they lie between {values.min():g} and {values.max():g}, like widths of pulses in us, "
                f"{off:g} closed and {on:g} open: a guess"
            )
            return
        period_s, usual = self.vehicle.sample_period_s, drop_rare_commands(values)
        scales = possible_scales(values, period_s)
        if usual.size < values.size:
            scales += [one for one in possible_scales(usual, period_s) if one not in scales]
            maxima = float(values.max()), float(usual.max())
            scales.sort(key=lambda one: not any(map(one.is_reached, maxima)))
        named = [one for one in scales if name.unit and _is_unit_of(name.unit, one)]
        if not named and name.is_on_time:
            named = [one for one in scales if one.is_timed]
        if not scales and values.any():
            self.lacking.append(
                f"commands, {', '.join(columns.values())}, go from {values.min():g} to {values.max():g}, which is "
                "neither a share, percent, an on-time within the sample period nor the width of a pulse: give "
                "commands.unit, off, on"
            )
        self._scales = [_scale_keys(one) for one in named or scales]
        if self._scales:
            best = (named or scales)[0]
            self._is_scale_sure = bool(named) or (usual.size == values.size and best.is_reached(float(values.max())))
            self.data["commands"] |= self._scales[0]
            why = "as their names say" if named else f"since they reach {values.max():g}"
            self._say(f"commands: {best.words}, {why}")

    def _take_levels(self, levels: Levels) -> None:
        """Writes the two levels of commands into the map, the more frequent one as that of a closed jet."""
        off, on = levels[:2]
        if "missing" in self.data["commands"]:  # disarmed jets are closed besides
            off, on = min(off, on), max(off, on)
        if (off, on) != (0.0, 1.0):
            self.data["commands"] |= {"off": off, "on": on}
        why = "the only two values"
        if levels.scatters or levels.beside:
            why = "about the only two values"
        if levels.scatters and not levels.beside:
            self.data["commands"]["threshold"] = 0.5
        self._say(f"commands: {off:g} closed and {on:g} open, {why}; which one is closed is a guess")
        if levels.beside:
            shown = ", ".join(f"{one:g}" for one in levels.beside[:3])
            self._say(f"commands: {shown} {'is' if len(levels.beside) == 1 else 'are'} rare, and neither of them")


def _varies(values: Array) -> bool:
    """Tests whether finite values are not all the same."""
    values = values[np.isfinite(values)]
    return bool(values.size) and bool((values != values[0]).any())


def _pulse_widths(values: Array) -> tuple[float, float]:
    """Returns pulse widths of a closed and an open jet, us: the two levels found, or else usual ones."""
    armed = values[values >= _CLOSED_PULSE]
    levels = np.unique(armed)
    if levels.size == 2:
        return float(levels[0]), float(levels[1])
    lowest, highest = (float(armed.min()), float(armed.max())) if armed.size else (1000.0, 2000.0)
    off, on = (1100.0, 1900.0) if lowest >= 1100.0 and highest <= 1900.0 else (1000.0, 2000.0)
    return min(off, lowest), max(on, highest)


def _scale_keys(scale: CommandScale) -> dict[str, Any]:
    """Returns a command scale as the keys of a map's `commands`: unit, or the value of an open jet."""
    if scale.unit != "1":
        return {"unit": scale.unit}
    return {} if scale.full == 1.0 else {"on": scale.full}


def _is_unit_of(unit: str, scale: CommandScale) -> bool:
    """Tests whether a unit read from a column's name equals that of a command scale."""
    kind = "time" if scale.is_timed else "number"
    factor, expected = si_factor_or_none(unit, kind), si_factor_or_none(scale.unit, kind)
    return factor is not None and factor == expected
