"""What a process that flies runs has in it: imported once, by whoever such processes are forked from.

A run imports much of this only when it comes to it (estimators, controllers and MAVLink's services are found by name);
here it is at hand before the first run, so that a process of a pool begins with flying.
"""
# ruff: noqa: F401

import autopilot.campaign.flight
import autopilot.control.controller
import autopilot.control.energy.energy_guidance
import autopilot.control.energy.search
import autopilot.control.robust.ancillary
import autopilot.control.robust.regions
import autopilot.control.robust.terminal
import autopilot.control.robust.tube
import autopilot.estimator.complementary
import autopilot.estimator.ekf
import autopilot.estimator.relocation
import autopilot.mavlink.server
