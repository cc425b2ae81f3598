"""The C sources under the address and undefined behaviour sanitizers: ``python -m tests.sanitize`` (``make sanitize``).

Builds the library as setup.py does, with the sanitizers, into a folder of its own, and runs the tests that hold C
against Python with it. What they find ends the run: accesses beyond an array, a float that no integer holds, overflows.
"""

import os
import shlex
import subprocess
import sys
import sysconfig
import tempfile
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
CHECKS = "-fsanitize=address,undefined,float-cast-overflow -fno-sanitize-recover=all -fno-omit-frame-pointer"
PATH_VARIABLE = "TESTS_COMPILED_LIBRARY"
"""Names the library for the tests' process (:mod:`tests.sanitized_library`)."""

TESTS = (
    *("control/test_compiled.py", "control/test_compiled_layout.py", "control/test_compiled_functions.py"),
    "control/test_not_finite.py",
    *("sitl/test_compiled_plant.py", "estimator/test_compiled_models.py", "estimator/test_compiled_fit.py"),
)
NOT_HERE = "a_library or without_the_library or switched_off or not_made_for or stripped"
"""Tests of the file itself are about the ordinary library; other solvers than ours are loaded in a
way that the sanitizer cannot follow."""


def build(folder: Path) -> Path:
    """The library with the sanitizers. CalledProcessError, FileNotFoundError when it cannot be built."""
    env = dict(os.environ)
    for name in ("CFLAGS", "LDFLAGS"):
        env[name] = f"{env.get(name, '')} {CHECKS}"
    command = [sys.executable, "setup.py", "-q", "build_ext", "--build-lib", str(folder), "--build-temp", f"{folder}/o"]
    subprocess.run(command, cwd=ROOT, env=env, check=True)
    return next(folder.glob("autopilot/core/_compiled*"))


def runtime() -> str:
    """Where the compiler has the library that has to be loaded first. FileNotFoundError if nowhere."""
    compiler = shlex.split(os.environ.get("CC") or sysconfig.get_config_var("CC") or "cc")[0]
    command = [compiler, "-print-file-name=libasan.so"]
    found = subprocess.run(command, capture_output=True, text=True, check=True).stdout.strip()
    if not Path(found).is_absolute():
        raise FileNotFoundError(f"{compiler} has no libasan.so: install the compiler's sanitizer libraries")
    return found


def main() -> int:
    with tempfile.TemporaryDirectory() as folder:
        library = build(Path(folder))
        env = os.environ | {
            PATH_VARIABLE: str(library),
            "LD_PRELOAD": runtime(),
            "ASAN_OPTIONS": f"detect_leaks=0:log_path={folder}/found",
            "UBSAN_OPTIONS": f"print_stacktrace=1:log_path={folder}/found",
        }
        tests = [f"tests/{name}" for name in TESTS]
        command = [sys.executable, "-m", "pytest", "-p", "tests.sanitized_library", "-k", f"not ({NOT_HERE})", *tests]
        code = subprocess.run([*command, *sys.argv[1:]], cwd=ROOT, env=env, check=False).returncode
        for found in sorted(
            Path(folder).glob("found.*")
        ):  # the tests' own output is captured, and lost when they end so
            print(found.read_text(encoding="utf-8", errors="replace"), file=sys.stderr)
            code = code or 1
        return code


if __name__ == "__main__":
    sys.exit(main())
