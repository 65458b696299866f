"""The registry that scenarios name filters by."""

from __future__ import annotations

from massprop_drake.maths.estimation.filter import Filter
from massprop_drake.maths.estimation.filters import joint, pose, thesis

FILTERS: dict[str, Filter] = {"joint": joint.FILTER, "pose": pose.FILTER, "thesis": thesis.FILTER}
