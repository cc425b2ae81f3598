"""Factors between medians and standard deviations of normally distributed errors, for robust estimates."""

MAD_TO_SIGMA = 1.4826
"""Standard deviation over the median of the absolute values: 1 / 0.6745."""
PLANAR_MEDIAN = 1.1774
"""Median length of a two-dimensional error over its standard deviation along one axis: sqrt(2 ln 2)."""
