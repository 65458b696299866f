"""Fields of nested data by dotted keys, as `--set` names them."""

from __future__ import annotations

import re
from collections.abc import Sequence
from itertools import pairwise
from typing import Any

from massprop_drake.errors import InputError

_INDEX = re.compile(r"[0-9]{1,6}")


def value_at(data: Any, path: Sequence[str | int]) -> Any:
    """Returns the value at a path in nested data; None where there is none."""
    for part in path:
        try:
            data = data[part]
        except (KeyError, IndexError, TypeError):
            return None
    return data


def set_at(data: Any, path: list[str | int], value: Any, where: str) -> None:
    """Sets one field of nested data; missing blocks are made.

    Args:
        data: mappings and lists.
        path: keys and indices; an index may be one past the end of its list.
        value: to set.
        where: what to call it in messages.

    Raises:
        InputError: when the path leads nowhere.
    """
    here = data
    for part, following in pairwise(path):
        if isinstance(part, str) and isinstance(here, dict):
            here = here.setdefault(part, [] if isinstance(following, int) else {})
            continue
        if isinstance(part, int) and isinstance(here, list) and part < len(here):
            here = here[part]
            continue
        raise InputError(f"{where}: there is no {part!r} to set in")
    last = path[-1]
    if isinstance(last, str) and isinstance(here, dict):
        here[last] = value
    elif isinstance(last, int) and isinstance(here, list) and last <= len(here):
        here[last : last + 1] = [value]
    else:
        raise InputError(f"{where}: there is no {last!r} to set")


def split_key(key: str, override: str) -> list[str | int]:
    """Splits a dotted key such as sensors.errors[0].noise_std into its parts.

    Raises:
        InputError: when it is none; the message begins with --set and the override.
    """
    path: list[str | int] = []
    for part in key.split("."):
        name, *indices = part.split("[")
        if name:
            path.append(name)
        for index in indices:
            if not index.endswith("]") or not _INDEX.fullmatch(index[:-1]):
                raise InputError(f"--set {override}: expected an index such as [0] in {key!r}")
            path.append(int(index[:-1]))
        if not name and not indices:
            raise InputError(f"--set {override}: empty part in {key!r}")
    return path
