"""The failsafe table as text: docs/failsafes.md and ``autopilot failsafes``."""

import re
from dataclasses import dataclass

from autopilot.command.failsafe_table import ACTIONS, EFFECTS, ROWS, FailsafeRow
from autopilot.command.failsafes import MARKER_FACTS
from autopilot.core.params import ParamSet

_NAMED = re.compile(r"`([A-Z0-9_]+)`")
_EXAMPLES = {
    "battery_low": "below 10 %",
    "thruster_problem": "heading cannot be held (thruster port)",
    "fault": "internal fault in controller",
    "silent_sensor": "depth sensor",
    "silence": "silent or frozen",
    "watchdog_problem": "hangs",
    **MARKER_FACTS,
}
"""What is put into messages."""
_ALL_ACTIONS = re.compile(", ".join(rf"(?:{n} {effect}|\*\*{n} {effect}\*\*)" for n, effect in enumerate(ACTIONS)))
_DEFAULT = re.compile(r"\*\*.+?\*\*")

BEGIN, END = "<!-- failsafes:begin -->", "<!-- failsafes:end -->"


@dataclass(frozen=True, slots=True, kw_only=True)
class FailsafeText:
    bit: int
    name: str
    condition: str
    over: str
    """When it ends, and whether it counts on the ground."""
    action: str
    message: str


def failsafe_texts() -> list[FailsafeText]:
    """All rows with the default values of their parameters, by bit."""
    params = ParamSet()
    return [_text(row, params) for row in sorted(ROWS, key=lambda row: row.rule)]


def failsafe_markdown() -> str:
    """Generated part of docs/failsafes.md."""
    lines = ["| bit | failsafe | begins when; over | action | text |", "| --- | --- | --- | --- | --- |"]
    lines += [
        f"| {text.bit} | {text.name} | {text.condition}{_ending(text.over)} | {_short(text.action)} | {text.message} |"
        for text in failsafe_texts()
    ]
    lines += ["", "| effect, weakest first | as a number | |", "| --- | --- | --- |"]
    numbers = {effect: str(n) for n, effect in enumerate(ACTIONS)}
    lines += [f"| {effect} | {numbers.get(effect, '')} | {meaning} |" for effect, meaning in EFFECTS.items()]
    return "\n".join(lines) + "\n"


def with_table(page: str) -> str:
    """A page with the table between its marks regenerated."""
    begin, end = page.index(BEGIN) + len(BEGIN), page.index(END)
    return f"{page[:begin]}\n{failsafe_markdown()}{page[end:]}"


def _ending(over: str) -> str:
    """Condition for clearing, if it differs from that for raising."""
    parts = [part for part in over.split(", ") if part != "at once"]
    return f"; over: {', '.join(parts)}" if parts else ""


def _short(action: str) -> str:
    """Only the default of a parameter that can take every action: the numbers stand beside the effects."""
    return _ALL_ACTIONS.sub(lambda found: "".join(_DEFAULT.findall(found[0])), action)


def _text(row: FailsafeRow, params: ParamSet) -> FailsafeText:
    return FailsafeText(
        bit=int(row.rule),
        name=row.rule.name,
        condition=_NAMED.sub(lambda found: _with_default(found[1], params), row.condition),
        over=_over(row),
        action=_action(row, params),
        message=row.text.format_map({**params, **_EXAMPLES}) + ("; no arming" if row.arming else ""),
    )


def _with_default(name: str, params: ParamSet) -> str:
    if name not in params:
        return f"`{name}`"
    spec = params.spec(name)
    return f"`{name}` ({f'{spec.default:g} {spec.unit}'.rstrip()})"


def _over(row: FailsafeRow) -> str:
    parts = [f"back by {row.gap:g}" if row.gap else "at once" if not row.leave_s else "gone"]
    parts += [f"for {row.leave_s:g} s"] if row.leave_s else []
    return " ".join(parts) + (", at disarming" if row.flying else "")


def _action(row: FailsafeRow, params: ParamSet) -> str:
    if not row.action:
        return row.effects[0]
    chosen = int(params[row.action])
    choices = ", ".join(f"**{n} {e}**" if n == chosen else f"{n} {e}" for n, e in enumerate(row.effects))
    return f"`{row.action}`: {choices}"
