"""Plans of the paper's tank as TOML text, in local metres."""

WORKSPACE = """
[origin]
lat_deg = 37.9755
lon_deg = 23.7790
alt_m = 0.0
[[fence.polygon]]
points_m = [[-2.5, -1.5], [2.5, -1.5], [2.5, 1.5], [-2.5, 1.5]]
inclusion = true
"""
"""Where it is, and its walls."""
PILLARS = ((-0.625, -0.625), (0.9375, 0.0))
"""North and east of its two cylinders [m]."""


def pillar(north_m: float, east_m: float) -> str:
    return f"[[fence.circle]]\nx_m = {north_m}\ny_m = {east_m}\nradius_m = 0.16\n"


def waypoint(north_m: float, east_m: float, depth_m: float, accept_m: float | None = None) -> str:
    accept = "" if accept_m is None else f"accept_m = {accept_m}\n"
    return f"[[waypoint]]\nx_m = {north_m}\ny_m = {east_m}\ndepth_m = {depth_m}\n{accept}"
