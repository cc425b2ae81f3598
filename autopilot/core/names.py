"""Messages about names that do not exist, with the one that was probably meant."""

import difflib
from collections.abc import Iterable, Sequence

from autopilot.core.errors import UnknownNameError

CLOSE = 0.6
"""Likeness (difflib) from which a name is taken for a slip of the pen."""


def nearest(name: str, names: Iterable[str]) -> str:
    """The one of ``names`` that was probably meant, "" if nothing is like it; capitals do not count."""
    known = {each.lower(): each for each in names}
    near = difflib.get_close_matches(name.lower(), known, 1, CLOSE)
    return known[near[0]] if near else ""


def did_you_mean(name: str, names: Iterable[str]) -> str:
    """``did you mean NAME? ``, "" if nothing is like it."""
    meant = nearest(name, names)
    return f"did you mean {meant}? " if meant else ""


def choice(name: str, names: Sequence[str]) -> str:
    """``use one of A, B, C``; the one that ``name`` was probably meant to be comes before."""
    if not names:
        return "correct or remove that key"
    unique = list(dict.fromkeys(names))
    return f"{did_you_mean(name, unique)}use one of {', '.join(unique)}"


def unknown(what: str, name: str, names: Sequence[str], *, more: str = "", list_by: str = "") -> UnknownNameError:
    """The error about a name that is not among ``names``.

    ``what``: kind of thing, or the option that names it. ``more``: goes on after the list of them. ``list_by``: how to
    list them, instead of the list.
    """
    remedy = f"{did_you_mean(name, names)}{list_by}" if list_by else choice(name, names)
    return UnknownNameError(f"{what} {name!r} is not known; {remedy}{more}")
