"""Legs of 60 to 85 m between 10 and 50 m deep, planned in a process of their own: memory, and nothing on stderr."""

import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]

MOST_MB = 200
"""Of the controller alone (130 here); the whole service may take 300."""

SCRIPT = """
import re, sys
from dataclasses import replace
import numpy as np
from autopilot.control.controller import MotionController
from autopilot.core.geometry import Fence
from autopilot.core.params import ParamSet
from control_loop import VEHICLE, goal, nav_state

places = [(0, 0, 10), (62, 10, 30), (40, 78, 50), (-35, 60, 20), (-70, 0, 45), (-20, -50, 12), (45, -60, 35)]
goals = [goal(*place, None) for place in places]
fence, params = Fence(depth_max_m=60.0), ParamSet({"MPC_COST": float(sys.argv[1]), "DEPTH_MAX": 60.0})
controller, t_us = MotionController(VEHICLE, cpu_clock=lambda: 0.0), 0
current, plans, thrust = np.array([0.12, -0.08, 0.0]), 0, []
for k in range(6):
    x = np.array([*places[k], 0.5, 0.0, 0.0, 0.0, 0.0], dtype=float)
    to = replace(goals[k + 1], following=goals[k + 2] if k < 5 else None)
    for _ in range(45):
        output = controller.step(t_us, nav_state(t_us, x, current), to, fence, params)
        plans += output.plan is not None
        thrust.append(output.thrust_n)
        t_us += 50_000
assert np.isfinite(thrust).all()
# getrusage would count the process that this one was forked from.
peak_kb = int(re.search(r"VmHWM:\\s+(\\d+)", open("/proc/self/status").read()).group(1))
print(plans, peak_kb // 1024)
"""


@pytest.mark.parametrize(("cost", "plans"), [(0, 0), (1, 6)])
def test_long_legs_take_little_memory_and_say_nothing(cost: int, plans: int) -> None:
    path = {"PYTHONPATH": f"{ROOT}:{ROOT / 'tests' / 'control'}"}
    done = subprocess.run(
        [sys.executable, "-c", SCRIPT, str(cost)], capture_output=True, text=True, check=False, env=path, cwd=ROOT
    )
    assert done.returncode == 0, done.stderr
    assert done.stderr == ""
    made, peak_mb = (int(word) for word in done.stdout.split())
    assert made == plans
    assert peak_mb < MOST_MB
