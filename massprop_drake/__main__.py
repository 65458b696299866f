"""Entry point of `python -m massprop_drake`, the same as `massprop`."""

from massprop_drake.cli.main import main

main()
