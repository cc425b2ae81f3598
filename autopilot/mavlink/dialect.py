"""The dialect: pymavlink's ``development`` with the additions of :mod:`autopilot.mavlink.extra_messages`.

``mav`` has the packaged messages and constants, ``extra`` those of ``underwater.xml``. Importing this module
registers both with the packaged decoder; a message defined in both is decoded with its newer fields.
"""

from pymavlink.dialects.v20 import development as mav

from autopilot.mavlink import extra_messages

extra = extra_messages.load()

mav.mavlink_map.update(extra.mavlink_map)

__all__ = ["extra", "mav"]
