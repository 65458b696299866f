"""Puts the folders diagrams/ and scenarios/ into the package; everything else is in pyproject.toml.

In the package they are symbolic links. Where a checkout has none, as one that was unpacked from an archive may, they
are taken from beside it.
"""

from pathlib import Path

from setuptools import find_packages, setup

PACKAGE = "massprop_drake"
unlinked = [name for name in ("diagrams", "scenarios") if not Path(PACKAGE, name, "__init__.py").is_file()]
missing = [name for name in unlinked if not Path(name, "__init__.py").is_file()]
if missing:
    raise SystemExit(f"{Path.cwd()}: has no folder {missing[0]}/, which {PACKAGE} needs; get the whole repository")

setup(
    packages=[*find_packages(include=[f"{PACKAGE}*"]), *(f"{PACKAGE}.{name}" for name in unlinked)],
    package_dir={"": ".", **{f"{PACKAGE}.{name}": name for name in unlinked}},
)
