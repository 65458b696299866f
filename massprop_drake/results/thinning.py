"""Downsamples long runs for plots and pages: rows are chosen, never averaged."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from massprop_drake.results.spool import Spool, blocks

Array = NDArray[np.float64]


def outstanding_rows(
    signals: Mapping[str, Array],
    n_rows: int,
    *,
    keys: tuple[str, ...],
    events: tuple[str, ...],
    peaks: tuple[str, ...] = (),
    buckets: int = 1000,
) -> NDArray[np.int_]:
    """Selects rows to plot, ascending: in each bucket the extremes of `keys`, maxima of `peaks`, and nonzero `events`.

    The run is cut into stretches of equal length. Of each are kept the rows at which a component of a key
    signal has its minimum or maximum, and up to four rows with an event; also the run's first and last row.

    Args:
        signals: by name, shape (n_rows, components).
        n_rows: number of rows.
        keys: signals whose minima and maxima are kept; NaN is passed over.
        peaks: signals whose maxima alone are kept.
        events: signals that mark an event where a component is not zero, NaN included. Keys, peaks and events that are
            not among the signals are passed over.
        buckets: number of stretches.

    Returns:
        Indices in ascending order; all of them for a run of up to four rows a stretch.
    """
    if n_rows <= 4 * buckets:
        return np.arange(n_rows)
    kept = {0, n_rows - 1}
    edges = np.linspace(0, n_rows, buckets + 1).astype(int)
    names = [name for name in dict.fromkeys((*keys, *peaks, *events)) if name in signals]
    start = 0
    # stretches that a block ends in go on in the next: extremes so far, per component
    extremes: dict[tuple[int, str, int, int], tuple[float, int]] = {}
    counts: dict[int, int] = {}
    for block in blocks(signals, *names):
        size = len(next(iter(block.values())))
        bucket = int(np.searchsorted(edges, start, side="right")) - 1
        while bucket < buckets and edges[bucket] < start + size:
            part = slice(max(int(edges[bucket]) - start, 0), min(int(edges[bucket + 1]) - start, size))
            for name in names:
                values = block[name][part]
                offset = start + part.start
                if name in keys or name in peaks:
                    _note_extremes(extremes, bucket, name, values, offset, (1, -1) if name in keys else (1,))
                if name in events:
                    rows = np.flatnonzero(~(values == 0.0).all(axis=1))[: max(0, 4 - counts.get(bucket, 0))]
                    counts[bucket] = counts.get(bucket, 0) + rows.size
                    kept.update((offset + rows).tolist())
            bucket += 1
        for key in [key for key in extremes if edges[key[0] + 1] <= start + size]:
            kept.add(extremes.pop(key)[1])
        start += size
    kept.update(row for _, row in extremes.values())
    return np.array(sorted(kept))


def _note_extremes(
    extremes: dict[tuple[int, str, int, int], tuple[float, int]],
    bucket: int,
    name: str,
    values: Array,
    offset: int,
    signs: tuple[int, ...],
) -> None:
    """Updates the dict of extremes so far, in place, by some rows of one signal in one stretch.

    Args:
        extremes: signed value and row by stretch, signal, column and sign; changed.
        bucket: number of the stretch.
        name: of the signal.
        values: its rows, shape (n, components).
        offset: index of the first of them in the run.
        signs: +1 for maxima, -1 for minima.
    """
    for column in range(values.shape[1]):
        component = values[:, column]
        finite = np.flatnonzero(np.isfinite(component))
        if not finite.size:
            continue
        for sign in signs:
            row = finite[np.argmax(sign * component[finite])]
            value = float(sign * component[row])
            key = (bucket, name, column, sign)
            if key not in extremes or value > extremes[key][0]:
                extremes[key] = (value, offset + int(row))


def pick_rows(
    signals: Mapping[str, Array], rows: NDArray[np.int_], *, excluded: tuple[str, ...] = ()
) -> dict[str, Array]:
    """Returns the chosen rows of every signal, by name; reads spooled signals once.

    Args:
        signals: by name.
        rows: indices in ascending order.
        excluded: names of signals to leave out.
    """
    all_names = signals.names if isinstance(signals, Spool) else signals
    names = [name for name in all_names if name not in excluded]
    picked: dict[str, Array] = {}
    start = 0
    for block in blocks(signals, *names):
        size = len(next(iter(block.values())))
        first, last = np.searchsorted(rows, [start, start + size])
        for name, values in block.items():
            if name not in picked:
                picked[name] = np.empty((rows.size, *values.shape[1:]))
            picked[name][first:last] = values[rows[first:last] - start]
        start += size
    return picked
