"""The exception tree.

``AutopilotError``
  ``ConfigError``   a configuration, scenario, vehicle or parameter file is wrong; nothing was changed
  ``PlanError``     a plan file or plan is wrong; the plan in force stays
  ``DriverError``   a device or link cannot be opened or has failed
  ``LogError``      a log cannot be read or written

Every message names the field, the value and the remedy. Data from the wire never raises: it is counted and dropped.
"""


class AutopilotError(Exception):
    """Base of every error that the service raises on purpose."""


class ConfigError(AutopilotError):
    """A configuration file or value is wrong. Nothing has been changed."""


class PlanError(AutopilotError):
    """A mission, fence or rally plan is wrong. The plan in force stays."""


class DriverError(AutopilotError):
    """A device or a link cannot be opened, or failed while in use."""


class LogError(AutopilotError):
    """A log cannot be read or written."""
