"""Heading of a vehicle on a circle."""

from enum import IntEnum


class OrbitYaw(IntEnum):
    """ORBIT_YAW_BEHAVIOUR (common.xml), as far as it makes sense here."""

    TO_CENTRE = 0
    INITIAL = 1
    FREE = 2
    ALONG = 3
