"""The extra ``analysis``: optional libraries that a vehicle does not need, and the error message without them."""

from importlib.util import find_spec

from autopilot.core.errors import ConfigError

ANALYSIS = ("bokeh", "matplotlib")
"""Reports and figures: imported by the commands that need them only."""


def without(library: str) -> ConfigError:
    """The error where a library of the extra is missing."""
    return ConfigError(
        f"this needs {library}, of the program's extra [analysis]: pip install 'underwater-autopilot[analysis]', "
        "or '.[analysis]' where its source is"
    )


def need_analysis() -> None:
    """ConfigError before hours of work that would end where the extra is missing."""
    for library in ANALYSIS:
        if find_spec(library) is None:
            raise without(library)
