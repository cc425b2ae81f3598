"""Puts the examples into docs/extend.md: ``python docs/extend.py --write``. Without it says whether they are in it."""

import re
import sys
from pathlib import Path

PAGE = Path(__file__).resolve().parent / "extend.md"
BLOCK = re.compile(r"<!-- (examples/\w+\.py) -->\n```python\n.*?\n```\n", re.DOTALL)


def page_with_examples() -> str:
    """The page with every marked block as its file is."""

    def block(found: re.Match[str]) -> str:
        text = (PAGE.parent / found[1]).read_text(encoding="utf-8")
        return f"<!-- {found[1]} -->\n```python\n{text}```\n"

    return BLOCK.sub(block, PAGE.read_text(encoding="utf-8"))


if __name__ == "__main__":
    if "--write" in sys.argv:
        PAGE.write_text(page_with_examples(), encoding="utf-8")
    elif PAGE.read_text(encoding="utf-8") != page_with_examples():
        sys.exit("docs/extend.md shows other examples than docs/examples has; python docs/extend.py --write")
