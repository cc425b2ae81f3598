"""Monte Carlo campaigns over seeds and spreads of a scenario: draw, fly, judge, store, summarise."""
