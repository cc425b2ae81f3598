"""Imports of a run, loaded once before worker processes are forked.

A run imports many of these lazily (estimators, controllers and MAVLink services are found by name); loading them
here lets a worker start flying at once.
"""
# ruff: noqa: F401

import scipy.interpolate
import scipy.sparse.csgraph
import scipy.spatial

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
