"""Readings of words of the thesis that leave room, one bound for each word wherever it stands.

Words that mean a quantity of their own ("some", "good", "kept") are read beside their claim.
"""

from __future__ import annotations

from reproduction.claims import AtLeast, AtMost, Between, Reading

# ratios
SLIGHTLY_MORE = Reading(Between(1.0, 2.0), "minor, slightly, somewhat: more, at most double")
SLIGHTLY_LESS = Reading(Between(0.5, 1.0), "slight: less, at least half")
COMPARABLE = Reading(Between(0.5, 2.0), "comparable, of the same size: within a factor of two")
SAME = Reading(Between(0.9, 1.1), "essentially the same: within 10 %")
SIGNIFICANT = Reading(AtLeast(1.5), "significant: half as much again")
CONSIDERABLE = Reading(AtLeast(2.0), "considerably: twofold")
MUCH_MORE = Reading(AtLeast(10.0), "much, rapidly: tenfold")
DRASTIC = Reading(AtLeast(10.0), "drastic: tenfold")
TREMENDOUS = Reading(AtLeast(100.0), "diverges, tremendous: a hundredfold")
SMALL = Reading(AtMost(1.0 / 3.0), "small: at most a third")
NOTICEABLE = Reading(AtLeast(0.05), "noticeable: a twentieth")
NEGLIGIBLE = Reading(AtMost(0.1), "negligible: at most a tenth")

# shares
TYPICALLY = Reading(AtLeast(0.8), "typically: four of five")
OFTEN = Reading(AtLeast(0.25), "often: one of four")
MUCH_OF = Reading(AtLeast(1.0 / 3.0), "much of: a third")
MOST_JETS = Reading(AtLeast(23), "most: more than half of 44")
NEARLY_ALL = Reading(AtLeast(0.99), "all but one in a hundred")
MARGINAL = Reading(AtMost(0.5), "marginal: at most half")

# consistency functions of three components, whose mean chi-square says to be 3
CHI_SQUARE = Reading(Between(2.5, 3.5), "follows chi-square: the mean rounds to 3")
INCONSISTENT = Reading(AtLeast(6.0), "inconsistent: twice the 3 of chi-square")
HIGHLY_INCONSISTENT = Reading(AtLeast(30.0), "highly inconsistent: ten times the 3 of chi-square")

# what an eye can see in a plot whose axis is as long as the initial error, 100 %
NOT_SEEN = Reading(AtMost(1.0), "not to be seen: a line's width, 1 % of the initial error")
GOOD = Reading(AtMost(1.0), "good: within 1 %")


def orders(low: int, high: int | None = None) -> Reading:
    """Reads "by n orders of magnitude", or "n to m", as the logarithm: n up to n + 1, or to m."""
    if high is not None:
        return Reading(Between(low, high), f"{low} to {high} orders: to the word")
    return Reading(Between(low, low + 1), f"{low} orders: at least that, not one more")
