"""Markdown pages as the tests read them: blocks, command lines, links, anchors."""

import itertools
import re
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
PAGES = sorted([ROOT / "README.md", *(ROOT / "docs").rglob("*.md"), *(ROOT / "tests").rglob("*.md")])
TESTED = "<!-- tested -->"
"""On the line before a block that the tests run."""


@dataclass(frozen=True)
class Block:
    """A fenced block."""

    page: Path
    line: int
    language: str
    text: str
    tested: bool

    @property
    def name(self) -> str:
        """For people."""
        return f"{self.page.relative_to(ROOT)}:{self.line}"

    @property
    def commands(self) -> list[str]:
        """Lines of a shell, continued ones as one, without comments."""
        joined = re.sub(r"\\\n\s*", " ", self.text)
        return [line for raw in joined.splitlines() if (line := re.sub(r"(^|\s)#.*$", "", raw).strip())]


@cache
def blocks(page: Path) -> tuple[Block, ...]:
    """Fenced blocks of a page."""
    found, lines = [], page.read_text(encoding="utf-8").splitlines()
    begin: int | None = None
    for number, line in enumerate(lines):
        fence = re.match(r"^(\s*)```(.*)$", line)
        if fence is None:
            continue
        if begin is None:
            begin, indent, language = number, len(fence[1]), fence[2].strip()
        else:
            text = "\n".join(each[indent:] for each in lines[begin + 1 : number])
            tested = lines[begin - 1].strip() == TESTED if begin else False
            found.append(Block(page, begin + 1, language, text, tested))
            begin = None
    assert begin is None, f"{page}: a block that begins in line {begin} has no end"
    return tuple(found)


def prose(page: Path) -> str:
    """The page without its blocks."""
    return re.sub(r"^\s*```.*?^\s*```\s*$", "", page.read_text(encoding="utf-8"), flags=re.MULTILINE | re.DOTALL)


def command_lines(page: Path) -> Iterator[str]:
    """Everything on a page that calls ``autopilot``, without the program's name; alternatives one by one."""
    lines = [line for block in blocks(page) if block.language in ("", "sh") for line in block.commands]
    lines += [" ".join(span.split()) for span in re.findall(r"`([^`]+)`", prose(page))]
    for line in lines:
        call = re.match(r"^(?:\S*/bin/)?autopilot (\S.*)$", line)
        if call is not None and not call[1].startswith("("):
            yield from alternatives(call[1].replace("\\|", "|"))


def alternatives(line: str) -> Iterator[str]:
    """``log info|check LOG`` as two; what stands in brackets is given."""
    words = line.replace("[", " ").replace("]", " ").replace("...", " ").split()
    for chosen in itertools.product(*(word.split("|") for word in words)):
        yield " ".join(chosen)


def links(page: Path) -> Iterator[str]:
    """Targets of links and pictures."""
    text = re.sub(r"`[^`]*`", "", prose(page))
    yield from re.findall(r"\]\(([^)\s]+)(?:\s+\"[^\"]*\")?\)", text)
    yield from re.findall(r"(?:src|href)=\"([^\"]+)\"", text)


@cache
def anchors(page: Path) -> frozenset[str]:
    """Names that headings of a page have, as GitHub makes them."""
    found: list[str] = []
    for title in re.findall(r"^#{1,6}\s+(.*?)\s*#*$", prose(page), flags=re.MULTILINE):
        plain = re.sub(r"\[([^\]]*)\]\([^)]*\)", r"\1", title).replace("`", "").replace("*", "")
        slug = re.sub(r"[^\w\- ]", "", plain.lower()).replace(" ", "-")
        number = sum(each == slug or re.fullmatch(re.escape(slug) + r"-\d+", each) is not None for each in found)
        found.append(slug if not number else f"{slug}-{number}")
    return frozenset(found) | frozenset(re.findall(r"<a (?:name|id)=\"([^\"]+)\"", prose(page)))
