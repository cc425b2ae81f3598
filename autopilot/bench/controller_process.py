"""Setup of a controller in a process of its own."""

import json
import time


def measure() -> dict[str, float]:
    """CPU time [ms] of imports and of building the controller, memory [MB] before and after 50 steps."""
    began = time.process_time()
    import numpy as np
    import psutil

    from autopilot.analysis.nmpc_flight import WAYPOINTS, fly
    from autopilot.control.controller import MotionController
    from autopilot.core.vehicle import load_vehicle

    vehicle = load_vehicle("lbv150")
    imported = time.process_time()
    controller = MotionController(vehicle)
    built = time.process_time()
    fly(controller, vehicle, np.array([*WAYPOINTS[1], 0.0, 0.0, 0.0, 0.0]), 50)
    return {
        "import_ms": 1e3 * (imported - began),
        "build_ms": 1e3 * (built - imported),
        "rss_mb": psutil.Process().memory_info().rss / 1e6,
    }


def main() -> None:
    print(json.dumps(measure()))
