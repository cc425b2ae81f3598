"""Which tests look at a module: by what they import, nearest first, quick folders first."""

import ast
from collections import deque
from functools import cached_property
from pathlib import Path

SLOW = ("system", "bench", "extend", "run", "docs")
"""Folders whose tests start processes: asked last."""

FAR = 99


class TestMap:
    """Distances from test modules to modules of the package along imports."""

    __test__ = False

    def __init__(self, root: Path) -> None:
        self._root = root
        self._imports: dict[Path, frozenset[Path]] = {}

    @cached_property
    def tests(self) -> list[Path]:
        """All test modules."""
        return sorted(path.relative_to(self._root) for path in (self._root / "tests").rglob("test_*.py"))

    def ranked(self, module: Path) -> list[Path]:
        """Test modules that reach a module, those likeliest to notice first."""
        scored = []
        for test in self.tests:
            distance = self._distance(test, module)
            if distance < FAR:
                near = test.parent.name in module.parts
                named = module.stem.removesuffix("s") in test.stem
                slow = test.parent.name in SLOW
                scored.append((2 * distance + 2 * (not near) - 3 * named + 4 * slow, str(test), test))
        return [test for _, _, test in sorted(scored)]

    def _distance(self, start: Path, goal: Path) -> int:
        seen, queue = {start}, deque([(start, 0)])
        while queue:
            path, distance = queue.popleft()
            if path == goal:
                return distance
            for other in self._imported(path) - seen:
                seen.add(other)
                # A helper of the tests is part of the test.
                queue.append((other, distance + (other.parts[0] != "tests")))
        return FAR

    def _imported(self, path: Path) -> frozenset[Path]:
        if path not in self._imports:
            tree = ast.parse((self._root / path).read_bytes())
            names: set[str] = set()
            for node in ast.walk(tree):
                if isinstance(node, ast.Import):
                    names |= {alias.name for alias in node.names}
                elif isinstance(node, ast.ImportFrom) and node.module and not node.level:
                    names |= {node.module, *(f"{node.module}.{alias.name}" for alias in node.names)}
            found = {self._file(name, path.parent) for name in names}
            self._imports[path] = frozenset(each for each in found if each is not None)
        return self._imports[path]

    def _file(self, name: str, beside: Path) -> Path | None:
        """Of a module of ours; helpers of tests are named without a package."""
        path = Path(*name.split(".")).with_suffix(".py")
        for candidate in (path, beside / path) if beside.parts[0] == "tests" else (path,):
            if (self._root / candidate).exists() and candidate.parts[0] in ("autopilot", "tests"):
                return candidate
        return None
