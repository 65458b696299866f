"""`python -m massprop_drake` is `massprop`."""

from massprop_drake.cli.app import main

main()
