"""Numbers of mission items in texts: as the protocol counts them, and as ground stations show them.

The protocol counts from 0, QGroundControl's plan from 1 (its row 0 is the settings). Texts are written with the
number in the store, ``item 1``; this adds what the operator sees: ``item 1 (QGC 2)``.
"""

import re

_ITEMS = re.compile(r"(?<!fence )(?<!rally )\b([Ii]tems? )(\d+(?:(?:, | and | to )\d+)*)")
_NUMBER = re.compile(r"\d+")


def counted(text: str, *, shift: int = 0, ahead: int = 1) -> str:
    """``text`` with the numbers of its mission items moved by ``shift``, and each named once as shown if that is
    ``ahead`` of it.
    """
    named: set[str] = set()

    def moved(numbers: str, by: int) -> str:
        return _NUMBER.sub(lambda number: str(int(number[0]) + by), numbers)

    def shown(found: re.Match[str]) -> str:
        here = moved(found[2], shift)
        if not ahead or here in named:
            return f"{found[1]}{here}"
        named.add(here)
        return f"{found[1]}{here} (QGC {moved(here, ahead)})"

    return _ITEMS.sub(shown, text)
