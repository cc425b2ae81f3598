"""Robust control: disturbance bound, tube, Lipschitz growth, terminal regions, the loop between optimiser steps."""
