"""The dialect: pymavlink's ``development``, and what it lacks (:mod:`autopilot.mavlink.extra_messages`).

``mav`` has the packaged messages and constants, ``extra`` those of ``underwater.xml``. Importing this module makes the
packaged decoder know both; a message that stands in both is decoded with its newer fields.
"""

from pymavlink.dialects.v20 import development as mav

from autopilot.mavlink import extra_messages

extra = extra_messages.load()

mav.mavlink_map.update(extra.mavlink_map)

__all__ = ["extra", "mav"]
