"""`python -m haptid`."""

from haptid.cli import main

main()
