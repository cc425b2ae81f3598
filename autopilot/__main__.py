"""``python -m autopilot`` is the console script; it does not import from the current folder either."""

import sys
from pathlib import Path

if not sys.flags.safe_path and Path(sys.path[0]).resolve() == Path.cwd() != Path(__file__).resolve().parents[1]:
    # -m has put the current folder first, and a mission.py that lies there would be imported in place of ours.
    del sys.path[0]

from autopilot.cli.main import main

main()
