"""Campaigns: many cases of one scenario, flown on one machine or many, and their statistics."""

from importlib.util import find_spec

from massprop_drake.errors import InputError

TO_FLY = ("dask", "distributed", "psutil", "threadpoolctl")  # packages that plans and reports do without


def require(what: str, *packages: str) -> None:
    """Checks that packages can be imported; InputError names the missing ones, and what needs them.

    Args:
        what: needs them, in the plural.
        packages: names to import.

    Raises:
        InputError: when one is not.
    """
    if missing := [name for name in packages if find_spec(name) is None]:
        raise InputError(f"{what} need {', '.join(missing)}: pip install 'massprop-drake[campaign]'")


require("campaigns", "pyarrow")
