"""Filters of mass properties, a file per variant, and the registry that scenarios name them by."""

from __future__ import annotations

from massprop_drake.maths.estimation.filter import Filter
from massprop_drake.maths.estimation.filters import joint, thesis

FILTERS: dict[str, Filter] = {
    "joint": joint.FILTER,
    "thesis": thesis.FILTER,
}
