"""Campaigns: many cases of one scenario, flown on one machine or many, and what they say together."""

from importlib.util import find_spec

from massprop_drake.errors import InputError

_EXTRA = ("dask", "distributed", "psutil", "pyarrow", "threadpoolctl")

if missing := [name for name in _EXTRA if find_spec(name) is None]:
    raise InputError(f"campaigns need {', '.join(missing)}: pip install 'massprop-drake[campaign]'")
