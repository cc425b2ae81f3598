"""Text in the arguments of a MAVLink event, whose types are numbers and enumerations only.

Reasons against arming have numbers, names and other devices' words in them, so a ground station could not make them
from a fixed message per reason. An argument of one byte is therefore an enumeration whose entries are pieces of text:
every printable ASCII character, and the pieces that shorten this project's reasons most (byte pair encoding over its
texts). A ground station prints the arguments of a message one after the other.
"""

from types import MappingProxyType

_FRAGMENTS = (
    " (| in | is | m| margin | s| to |, |, or |, restar|: |: check |: check cable and |: check the |: re|"
    ": set |: upload one (|; |; give |; use |AHRS|DEPTH_M|FENCE_REQUIRED |_TIME|markers |silent |a |above |"
    "again|al|an|and |ange |ar|arm|at|ation|back|battery |be |below |beyond |calibration |camera |cannot |ch|"
    "check |control|de|denied: |depth |depth band |dis|does not |e |e is |ed|ed |ed: |en|ent |er|er |es |estim|"
    "fail|fence|fence |fence and |first|flight controller|for |from |has |high|hull |in|in an |in the |ing|"
    "ing |ion|ion |is |is empty|is not |it|it |item |its |itude |le|le |leaves |lo|maller |map or |miss|mode |"
    "n |no |no position |not |obstacle|of |ol|only warn|or|or |origin|orrec|other |out of |outside |param|"
    "pilot |plan|plan |por|position |re|read|refused: |rejected: check |res|s |s are |s, |source|st|sur|"
    "suspect: check |t |t the |t: |te|ter|ter |th|that |the|the |the depth band |the fence |the fence or |"
    "the vehicle |ther|thrus|thruster|thruster |ting|too |use |vehicle |ver|vice|waypoin|with|without |y "
)
"""Divided by bars; as many as there are codes left."""
_FIRST = 0x20
"""Characters from here on have their own code; 0 is the empty piece that fills up."""
PIECES = MappingProxyType(
    {0: ""}
    | {code: chr(code) for code in range(_FIRST, 0x7F)}
    | dict(zip((*range(1, _FIRST), *range(0x7F, 0x100)), _FRAGMENTS.split("|"), strict=True))
)
"""Code -> text."""
_CODES = {text: code for code, text in PIECES.items()}
_LONGEST = max(len(text) for text in PIECES.values())
GOES_ON = "... "


def spelled(text: str, size: int, most: int) -> list[bytes]:
    """The codes of a text in at most ``most`` lines of ``size`` codes, split at spaces; a further line begins with
    three dots, and so ends a text that is too long."""
    lines: list[bytes] = []
    rest = text.encode("ascii", errors="replace").decode("ascii")
    rest = "".join(char if char.isprintable() else " " for char in rest)
    while rest:
        codes = _shortest(rest)
        if len(codes[-1]) <= size:
            return [*lines, codes[-1]]
        last = len(lines) == most - 1
        room = size - len(_shortest(GOES_ON.rstrip())[-1]) if last else size
        fits = [end for end in range(1, len(rest)) if len(codes[end]) <= room]
        end = max((end for end in fits if rest[end] == " " and end > len(GOES_ON)), default=fits[-1])
        if last:
            return [*lines, codes[end] + _shortest(GOES_ON.rstrip())[-1]]
        lines.append(codes[end])
        rest = GOES_ON + rest[end:].lstrip()
    return lines


def _shortest(text: str) -> list[bytes]:
    """The fewest codes of every beginning of a text, by its length."""
    codes = [b""]
    for end in range(1, len(text) + 1):
        begins = range(max(0, end - _LONGEST), end)
        codes.append(
            min(
                (codes[begin] + bytes((_CODES[text[begin:end]],)) for begin in begins if text[begin:end] in _CODES),
                key=len,
            )
        )
    return codes
