"""The dialect: pymavlink's ``development`` with the additions of :mod:`autopilot.mavlink.extra_messages`.

``mav`` has the packaged messages and constants, ``extra`` those of ``underwater.xml``. Importing this module
registers both with the packaged decoder; a message defined in both is decoded with its newer fields.
"""

from pymavlink.dialects.v20 import development as mav

from autopilot.mavlink import extra_messages

extra = extra_messages.load()

mav.mavlink_map.update(extra.mavlink_map)


def message_ids(names: str) -> frozenset[int]:
    """Ids of messages by their names, divided by spaces."""
    return _numbers("MAVLINK_MSG_ID_", names)


def command_ids(names: str) -> frozenset[int]:
    """Numbers of commands by their names without MAV_CMD, divided by spaces."""
    return _numbers("MAV_CMD_", names)


def _numbers(prefix: str, names: str) -> frozenset[int]:
    constants = vars(mav) | vars(extra)
    return frozenset(constants[prefix + name] for name in names.split())


__all__ = ["command_ids", "extra", "mav", "message_ids"]
