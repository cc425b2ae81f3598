"""Monte Carlo over seeds and spreads of a scenario: draw, fly, judge, keep, sum up."""
