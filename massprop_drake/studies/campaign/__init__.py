"""Campaigns: many cases of one scenario, flown on one machine or many, and their statistics."""

from importlib.util import find_spec

from massprop_drake.errors import InputError

TO_FLY = ("dask", "distributed", "psutil", "threadpoolctl")  # packages that plans and reports do without


def require_packages(feature: str, *packages: str) -> None:
    """Checks that the packages that a feature needs can be imported; InputError names the missing ones.

    Args:
        feature: what needs them, in the plural, for the message.
        packages: names to import.
    """
    if missing := [name for name in packages if find_spec(name) is None]:
        raise InputError(f"{feature} need {', '.join(missing)}: pip install 'massprop-drake[campaign]'")


require_packages("campaigns", "pyarrow")
