"""`python -m massprop_drake` is `massprop`."""

from massprop_drake.cli.main import main

main()
