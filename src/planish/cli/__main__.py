"""``python -m planish.cli`` is the same as ``planish``."""

from planish.cli.main import main

main()
