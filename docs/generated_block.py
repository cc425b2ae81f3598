"""A table of a page that a script writes between its lines ``<!-- NAME:begin -->`` and ``<!-- NAME:end -->``."""

import argparse
import re
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple


class GeneratedBlock(NamedTuple):
    page: Path
    name: str
    table: Callable[[], str]

    def written(self, text: str) -> str:
        """The page with the table as it should be."""
        block = re.compile(rf"(<!-- {self.name}:begin -->\n).*?(<!-- {self.name}:end -->)", re.S)
        found, count = block.subn(lambda lines: f"{lines[1]}{self.table()}\n{lines[2]}", text)
        if count != 1:
            raise SystemExit(f"{self.page}: the lines {self.name}:begin and {self.name}:end are missing")
        return found

    def main(self, description: str | None) -> int:
        """By the command line: 0 = current (or written)."""
        parser = argparse.ArgumentParser(description=description)
        parser.add_argument("--write", action="store_true", help="bring the page in line")
        write = parser.parse_args().write
        before = self.page.read_text(encoding="utf-8")
        after = self.written(before)
        if write:
            self.page.write_text(after, encoding="utf-8")
        return 0 if write or before == after else 1
