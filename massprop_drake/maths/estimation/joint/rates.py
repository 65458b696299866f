r"""Steps of the joint estimator where sensors are read at rates and times of their own.

It then takes one for every time at which anything is read. What was laid out for one step in a control period T keeps
its meaning in seconds: with an interval of the length dt,

    impulses     errors of repeatability are white in time: their variance is that over T times dt/T
    products     of errors of constants are the same in every interval: as noise they count as over T, times dt/T

Memories are as long in seconds as with one step a period: they hold so many more steps.
"""

from __future__ import annotations

from typing import NamedTuple

from massprop_drake.maths.kernels import kernel


class Rates(NamedTuple):
    """Steps of the filter.

    Attributes:
        period_s: control period T where steps are taken as readings come; 0: a step is taken every period.
        steps: steps in a control period, rounded up: by so many memories are longer that count steps.
    """

    period_s: float
    steps: int


EVERY_PERIOD = Rates(0.0, 1)


@kernel
def intervals_per_period(duration_s: float, rates: Rates) -> float:
    """Computes how many intervals of a length fit a control period; 1 where a step is taken every period.

    Args:
        duration_s: length of the interval.
    """
    return max(rates.period_s / duration_s, 1.0) if rates.period_s > 0.0 else 1.0
