"""Rooms: workspaces, waters, missions and vehicles made at random, flown by the whole service and judged apart from it.

:mod:`~autopilot.campaign.rooms.random_world` makes a room out of a seed, :mod:`~autopilot.campaign.rooms.prospect`
works out on its own what can be reached there and how soon, :mod:`~autopilot.campaign.rooms.world_flight` flies it and
:mod:`~autopilot.campaign.rooms.verdict` compares both.
"""
