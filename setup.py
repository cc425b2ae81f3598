"""The part of the build that pyproject.toml cannot say: the library in C (decision 82), which needs a C compiler.

One library serves all vehicles (`THRUSTERS`) and, on x86-64, processors with and without AVX2. It uses nothing of
Python, so that one wheel serves all versions of Python on a platform.
"""

import platform
import runpy
import sys
from importlib import import_module
from pathlib import Path

from setuptools import Extension, setup
from setuptools.command.bdist_wheel import bdist_wheel
from setuptools.command.build_ext import build_ext
from setuptools.errors import CCompilerError, CompileError, ExecError, PlatformError

HERE = Path(__file__).resolve().parent
SOURCES = HERE / "autopilot" / "data" / "native"
THRUSTERS = range(4, 9)
ONCE = ("surroundings", "reference", "program", "follow", "water", "estimator", "corner_fit", "plant", "interval")
"""Sources that are the same for all vehicles and processors."""

GENERATED = {
    "model.c": ("autopilot.control.nmpc.model_code", "model_code"),
    "interval.c": ("autopilot.control.energy.interval", "interval_code"),
}
"""Sources that CasADi writes of the model's expressions: module and function that give the text."""

NO_COMPILER = """\
the autopilot's library in C could not be built: {error}
Install a C compiler and try again (Debian, Ubuntu, Raspberry Pi OS: sudo apt install gcc python3-dev), \
or install a wheel that was built for this platform (pip wheel, docs/deploy.md)."""

FLAGS = ["-O2", "-g0", "-std=c99", "-fno-math-errno", "-fno-trapping-math", "-fno-wrapv", "-fvisibility=hidden"]
WIDE = """\
#if defined(__clang__)
#pragma clang attribute push(__attribute__((target("avx2,fma"))), apply_to = function)
#else
#pragma GCC target("avx2,fma")
#endif
"""
WIDE_END = """\
#if defined(__clang__)
#pragma clang attribute pop
#endif
"""


def variants() -> list[tuple[int, str]]:
    """Thrusters and kind of processor."""
    kinds = ("plain", "wide") if platform.machine().lower() in ("x86_64", "amd64") else ("plain",)
    return [(thrusters, kind) for thrusters in THRUSTERS for kind in kinds]


def generate(folder: Path) -> None:
    """Write the generated sources. CompileError without CasADi."""
    sys.path.insert(0, str(HERE))
    try:
        for name, (module, function) in GENERATED.items():
            (folder / name).write_text(getattr(import_module(module), function)(), encoding="utf-8")
    except ImportError as error:
        raise CompileError(f"needs {error.name} to write the model in C: pip install casadi numpy") from error
    finally:
        sys.path.remove(str(HERE))


class BuildStep(build_ext):
    """Writes the model and one source per variant, has them compiled, and seals the library."""

    def get_ext_filename(self, ext_name: str) -> str:
        """Without the version of Python."""
        path = Path(super().get_ext_filename(ext_name))
        return str(path.with_name(path.name.split(".")[0] + path.suffix))

    def run(self) -> None:
        try:
            super().run()
        except (CCompilerError, ExecError, PlatformError) as error:
            raise PlatformError(NO_COMPILER.format(error=error)) from error

    def build_extension(self, ext: Extension) -> None:
        work = Path(self.build_temp) / "step"
        work.mkdir(parents=True, exist_ok=True)
        generate(work)
        ext.include_dirs.append(str(work))
        for thrusters, kind in variants():
            path = work / f"step_{thrusters}_{kind}.c"
            names = "".join(
                f"#define {name.upper()} {name}_{thrusters}_{kind}\n" for name in ("control_step", "workspace_bytes")
            )
            wide = kind == "wide"
            path.write_text(
                f"{WIDE if wide else ''}{names}enum {{ NU = {thrusters} }};\n"
                f'#include "model.c"\n#include "step.c"\n{WIDE_END if wide else ""}'
            )
            ext.sources.append(str(path))
        listed = " ".join(f"VARIANT({thrusters}, {kind})" for thrusters, kind in variants())
        library = work / "library.c"
        wide = "#define WIDE\n" if any(kind == "wide" for _, kind in variants()) else ""
        library.write_text(f"{wide}#define VARIANTS {listed}\n#include <library.c>\n")
        ext.sources.append(str(library))
        for name in ONCE:
            once = work / f"{name}_once.c"
            once.write_text(f"#include <{name}.c>\n")
            ext.sources.append(str(once))
        super().build_extension(ext)
        tools = runpy.run_path(str(HERE / "autopilot" / "core" / "seal.py"))
        tools["seal"](Path(self.get_ext_fullpath(ext.name)), SOURCES)


class PlatformWheel(bdist_wheel):
    """For every Python 3 of this platform."""

    def get_tag(self) -> tuple[str, str, str]:
        return "py3", "none", super().get_tag()[2]


setup(
    ext_modules=[
        Extension(
            "autopilot.core._compiled",
            sources=[],
            include_dirs=[str(SOURCES)],
            depends=[str(path.relative_to(HERE)) for path in SOURCES.glob("*.[ch]")],
            extra_compile_args=FLAGS,
            libraries=["m"],
        )
    ],
    cmdclass={"build_ext": BuildStep, "bdist_wheel": PlatformWheel},
)
