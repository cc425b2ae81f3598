"""Random worlds: workspaces, currents, missions and vehicles, flown by the whole service and judged independently.

:mod:`~autopilot.campaign.worlds.random_world` draws a world from a seed,
:mod:`~autopilot.campaign.worlds.reachability` computes independently which goals are reachable and how soon,
:mod:`~autopilot.campaign.worlds.world_flight` flies it and :mod:`~autopilot.campaign.worlds.world_judge` compares
both.
"""
