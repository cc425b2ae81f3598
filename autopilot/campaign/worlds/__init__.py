"""Rooms: workspaces, waters, missions and vehicles made at random, flown by the whole service and judged apart from it.

:mod:`~autopilot.campaign.worlds.random_world` draws a world from a seed,
:mod:`~autopilot.campaign.worlds.reachability` computes independently what can be reached there and how soon,
:mod:`~autopilot.campaign.worlds.world_flight` flies it and :mod:`~autopilot.campaign.worlds.world_judge` compares both.
"""
