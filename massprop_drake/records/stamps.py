"""Numbers and stamps of time as recorders write them."""

from __future__ import annotations

import re
from typing import Any

import numpy as np

from massprop_drake.records.completeness import MISSING

_ZONE = re.compile(
    r"(?P<stamp>.*\d)\s*(?:Z|UTC|GMT)|(?P<local>.*:.*\d)\s*(?P<hours>[+-]\d\d)(?::?(?P<minutes>\d\d))?", re.IGNORECASE
)
_DAY_OF_YEAR = re.compile(r"(\d{4})-(\d{3})(?=$|[T ])")
_CLOCK = re.compile(r"\d\d?:\d\d(:|$)")
_SPELLED = re.compile(r"(\d\d?)[ -]([A-Za-z]{3})[ -](\d{4})(?=\s)")
_MONTHS = ("jan", "feb", "mar", "apr", "may", "jun", "jul", "aug", "sep", "oct", "nov", "dec")


def parse_stamp(text: str) -> np.datetime64 | None:
    """Parses a UTC time stamp to datetime64; NaT if missing, None for other text; a time alone is of 1970-01-01.

    A stamp is one of ISO 8601, also with the day of the year, or a date like 01 Jan 2000. One without a zone is UTC.
    """
    text = text.strip()
    if text.lower() in MISSING:
        return np.datetime64("NaT")
    zone, ahead = _ZONE.fullmatch(text), np.timedelta64(0, "m")
    if zone is not None and zone["hours"]:
        minutes = 60 * int(zone["hours"][1:]) + int(zone["minutes"] or 0)
        ahead = np.timedelta64(-minutes if zone["hours"][0] == "-" else minutes, "m")
    plain = (text if zone is None else zone["stamp"] or zone["local"]).replace("/", "-").replace(",", ".")
    if _CLOCK.match(plain):
        plain = f"1970-01-01T{plain if plain[2] == ':' else '0' + plain}"
    spelled = _SPELLED.match(plain)
    if spelled is not None and spelled.group(2).lower() in _MONTHS:
        date = int(spelled.group(3)), 1 + _MONTHS.index(spelled.group(2).lower()), int(spelled.group(1))
        plain = "{:04d}-{:02d}-{:02d}".format(*date) + plain[spelled.end() :]
    of_year, day = _DAY_OF_YEAR.match(plain), np.timedelta64(0, "D")
    if of_year is not None:
        day = np.timedelta64(int(of_year.group(2)) - 1, "D")
        plain = f"{of_year.group(1)}-01-01{plain[of_year.end() :]}"
    if not plain[:4].isdigit() or plain[4:5] != "-" or any(sign in plain[10:] for sign in "+-"):
        return None  # what stands for a zone there is none
    try:
        return np.datetime64(plain, "ns") + day - ahead
    except ValueError:
        return None


def is_number(cell: Any) -> bool:
    """Tests whether a cell is a number, or empty as of a missing one."""
    text = str(cell).strip().lower()
    if text in MISSING:
        return True
    try:
        float(text)
    except ValueError:
        return False
    return "_" not in text
