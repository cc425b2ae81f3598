"""``python -m autopilot`` is the console script."""

from autopilot.cli.main import main

main()
