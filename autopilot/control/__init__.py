"""Motion control: planner, NMPC, fallbacks and thrust allocation. Pure numerics, imports core only."""
