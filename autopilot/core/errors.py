"""Exceptions.

``AutopilotError``
  ``ConfigError``   invalid configuration, scenario, vehicle or parameter file; nothing was changed
    ``SourceError``  a file or folder of another kind than the command reads
      ``UnknownNameError``  no scenario, vehicle, parameter ... has that name
  ``PlanError``     invalid plan or plan file; the active plan stays
  ``DriverError``   a device or link cannot be opened or has failed
  ``LogError``      a log cannot be read or written

Every message names the field, the value and the remedy. Received data never raises: invalid data is counted and
dropped.
"""


class AutopilotError(Exception):
    """Base class of all errors that are raised on purpose."""


class ConfigError(AutopilotError):
    """A configuration file or value is invalid. Nothing has been changed."""


class SourceError(ConfigError):
    """What was given is no folder of images, no film, ...: a usage error."""


class UnknownNameError(SourceError):
    """There is nothing of that name: a usage error."""


class PlanError(AutopilotError):
    """A mission, fence or rally plan is invalid. The active plan stays."""


class DriverError(AutopilotError):
    """A device or a link cannot be opened, or failed while in use."""


class LogError(AutopilotError):
    """A log cannot be read or written."""
