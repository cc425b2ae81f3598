"""What is laid out twice, in C and in Python, and arrays whose address the library is given."""

import ctypes
import importlib
import re
from pathlib import Path
from typing import Any, cast

import numpy as np
import pytest
from control_loop import MODEL, nav_state

import autopilot
from autopilot.control.bounds import PlanClearance, largest_gap
from autopilot.control.constraints.obstacles import Features
from autopilot.control.current.current_learning import FlowFit
from autopilot.control.nmpc.grid import uniform_grid
from autopilot.control.robust.margins import Margins
from autopilot.core import compiled
from autopilot.core.compiled import Mirror
from autopilot.core.errors import ConfigError
from autopilot.core.geometry import Circle, Fence
from autopilot.core.params import ParamSet

ADDRESS = ctypes.c_void_p
KINDS: dict[str, Any] = {"void": None, "long": ctypes.c_long, "double": ctypes.c_double}
"""Of C and of ctypes. Any other type, ``int`` for one, raises KeyError: the sources do not exchange it."""

PACKAGE = Path(autopilot.__file__).parent
GRID = uniform_grid(5)


def _mirrors() -> dict[str, type[Mirror]]:
    """Of all modules, by the name of the struct."""
    found = {}
    for path in _sources():
        for name in re.findall(r"^class (\w+)\((?:\w+\.)?Mirror\):", path.read_text(encoding="utf-8"), re.MULTILINE):
            module = ".".join(("autopilot", *path.relative_to(PACKAGE).with_suffix("").parts))
            found[name.lstrip("_")] = cast(type[Mirror], getattr(importlib.import_module(module), name))
    return found


def _sources() -> list[Path]:
    """The package's modules, those behind its symbolic links as well."""
    folders = [PACKAGE, *(path for path in PACKAGE.iterdir() if path.is_symlink())]
    return sorted({path for folder in folders for path in folder.rglob("*.py")})


def test_every_struct_is_checked_field_by_field() -> None:
    """A struct beside the mirrors would be used unchecked."""
    for path in _sources():
        if path.name != "compiled.py":
            assert "(ctypes.Structure)" not in path.read_text(encoding="utf-8"), f"{path}: make it a Mirror"
    code = "".join(path.read_text(encoding="utf-8") for path in compiled.SOURCES.glob("*.[ch]"))
    laid_out = set(re.findall(r"^LAYOUT\((\w+),", code, re.MULTILINE))
    assert set(_mirrors()) == laid_out
    assert len(laid_out) >= 12


def _code() -> str:
    """The C sources without comments."""
    code = "\n".join(path.read_text(encoding="utf-8") for path in sorted(compiled.SOURCES.glob("*.[ch]")))
    return re.sub(r"/\*.*?\*/", "", code, flags=re.DOTALL)


def _kind(declared: str) -> Any:
    """ctypes' type of a parameter or of a result."""
    words = declared.replace("const ", "").split()
    return ADDRESS if "*" in declared or "[" in declared else KINDS[words[0]]


def _prototypes(code: str) -> dict[str, tuple[Any, ...]]:
    """Result and arguments of every function that is exported."""
    found = re.findall(r"^EXPORT ([\w ]+[ *])(\w+)\(([^()]*)\) *\{", code, re.MULTILINE)
    return {name: (_kind(result), *(_kind(each) for each in given.split(","))) for result, name, given in found}


def _fields(body: str) -> list[tuple[str, Any]]:
    """Name and type of the fields of a C struct; of an array the type of its elements."""
    fields = []
    for line in filter(None, (each.strip() for each in re.sub(r"\[[^]]*\]", "", body).split(";"))):
        kind, names = line.removeprefix("const ").split(maxsplit=1)
        each = (name.strip() for name in names.split(","))
        fields.extend((name.lstrip("*"), ADDRESS if name.startswith("*") else KINDS[kind]) for name in each)
    return fields


def _elements(kind: Any) -> Any:
    while issubclass(kind, ctypes.Array):
        kind = kind._type_
    return kind


def test_a_prototype_is_read_as_ctypes_has_to_give_it() -> None:
    code = "EXPORT long some(const Place *a, long m,\n  const double *x, double at[3], double dt) {"
    code += "\nEXPORT void none(long n) {"
    arguments = ADDRESS, ctypes.c_long, ADDRESS, ADDRESS, ctypes.c_double
    assert _prototypes(code) == {"some": (ctypes.c_long, *arguments), "none": (None, ctypes.c_long)}
    with pytest.raises(KeyError, match="int"):
        _prototypes("EXPORT void short(int n) {")


def test_every_function_is_called_as_its_prototype_says() -> None:
    """Without argument types ctypes passes a Python int as a C int, and any number of arguments."""
    code = _code()
    prototypes = _prototypes(code)
    assert len(re.findall(r"^EXPORT \w[^;{]*\) *\{", code, re.MULTILINE)) == len(prototypes)
    assert prototypes == compiled.SIGNATURES


def test_the_loaded_library_has_these_signatures() -> None:
    library = compiled.load()
    for name, (result, *arguments) in compiled.SIGNATURES.items():
        function = getattr(library, name)
        assert (function.restype, function.argtypes) == (result, arguments), name


@pytest.mark.parametrize("name", sorted(_mirrors()))
def test_a_mirror_has_the_types_of_its_struct(name: str) -> None:
    """A whole number, a float and an address are of the same size: the layout does not tell them apart."""
    structs = {struct: body for body, struct in re.findall(r"typedef struct \{([^}]*)\} (\w+);", _code())}
    assert [(field[0], _elements(field[1])) for field in _mirrors()[name]._fields_] == _fields(structs[name])


@pytest.mark.parametrize("name", sorted(_mirrors()))
def test_a_mirror_is_what_the_library_has(name: str) -> None:
    mirror = _mirrors()[name]
    assert compiled.library(mirror) is not None
    size, fields = compiled.layout_of(compiled.load(), name)
    assert size == ctypes.sizeof(mirror)
    assert [field[0] for field in fields] == [field[0] for field in mirror._fields_]
    ends = [offset + length for _, offset, length in fields]
    # No field of C is missing in between: what follows begins where its own alignment lets it.
    assert all(0 <= begin - end < 8 for begin, end in zip([f[1] for f in fields[1:]], ends, strict=False))
    assert 0 <= size - ends[-1] < 8


@pytest.mark.parametrize("name", sorted(_mirrors()))
def test_a_mirror_that_differs_is_refused(name: str) -> None:
    """Other order, another length, a field less: of the same size in the first case."""
    own = list(_mirrors()[name]._fields_)
    first, second = next((i, i + 1) for i in range(len(own) - 1) if own[i][1] is own[i + 1][1])
    swapped = own.copy()
    swapped[first], swapped[second] = own[second], own[first]
    longer = [(own[0][0], ctypes.c_byte * (ctypes.sizeof(own[0][1]) + 8)), *own[1:]]
    for fields in (swapped, longer, own[:-1], [*own, ("more", ctypes.c_long)]):
        other = type(f"_{name}", (Mirror,), {"_fields_": fields})
        assert compiled.library(other) is None
        with pytest.raises(ConfigError, match=f"another version: {name}"):
            compiled.load(other)
    with pytest.raises(ConfigError, match="it has no struct Unknown"):
        compiled.load(type("Unknown", (Mirror,), {"_fields_": own}))


def test_half_planes_are_not_written_beyond_their_arrays() -> None:
    features = Features(Fence(inclusions=(Circle(center_ned_m=np.zeros(2), radius_m=3.0),), exclusions=()))
    assert features._quick is not None
    path, t_s, keep = np.zeros((6, 2)), np.linspace(0.0, 1.0, 6), np.full(5, 0.2)
    normals, offsets = np.zeros((5, 3, 2)), np.zeros((5, 3))
    margin = features._quick.margin_m
    assert margin(path, t_s, keep, 3, normals, offsets) == pytest.approx(2.8)
    wrong: list[tuple[str, tuple[Any, ...]]] = [
        ("normals", (path, t_s, keep, 3, normals[:4], offsets)),
        ("normals", (path, t_s, keep, 4, normals, offsets)),
        ("offsets", (path, t_s, keep, 3, normals, offsets[:4])),
        ("offsets", (path, t_s, keep, 3, normals, offsets.astype(np.float32))),
        ("t_s", (path, t_s[:5], keep)),
        ("radius_m", (path, t_s, keep[:4])),
    ]
    for name, given in wrong:
        with pytest.raises(ValueError, match=rf"^{name} is .*; give contiguous float64 \("):
            margin(*given)


def test_other_arrays_that_are_too_short_are_refused() -> None:
    tube, params = Margins(MODEL, GRID).tube, ParamSet()
    nav, thrust = nav_state(0, np.zeros(8)), np.zeros((GRID.n, MODEL.thrusters))
    tube.back_offs(nav, np.zeros((GRID.n + 1, 8)), thrust, params)
    for shape in ((GRID.n, 8), (GRID.n + 1, 7), (1, 8)):
        with pytest.raises(ValueError, match=r"^x is float64 .*; give contiguous float64 \(6, 8\)"):
            tube.back_offs(nav, np.zeros(shape), thrust, params)
    with pytest.raises(ValueError, match="does not fit to plane_d_m"):
        PlanClearance(np.zeros((4, 2)), np.zeros((5, 3, 2)), np.zeros((5, 3)))
    with pytest.raises(ValueError, match=r"^plane_n is"):
        PlanClearance(np.zeros((5, 2)), np.zeros((5, 2, 2)), np.zeros((5, 3)))
    with pytest.raises(ValueError, match=r"^b is"):
        largest_gap(np.zeros((9, 8)), np.zeros((8, 8)), 0, 2)
    with pytest.raises(ValueError, match="columns 6 to 9 of 8"):
        largest_gap(np.zeros((9, 8)), None, 6, 3)
    with pytest.raises(ValueError, match=r"^pull is"):
        FlowFit(length_m=1.0, places_ned_m=np.zeros((3, 2)), pull=np.zeros((2, 2)), mean_m_s=np.zeros(2))


def test_many_rounds_and_no_edges_are_looked_at_where_they_are() -> None:
    rng = np.random.default_rng(1)
    rounds = tuple(Circle(center_ned_m=rng.uniform(-50.0, 50.0, 2), radius_m=0.3) for _ in range(120))
    features, points = Features(Fence(inclusions=(), exclusions=rounds)), rng.uniform(-50.0, 50.0, (40, 2))
    assert features.many
    expected = np.minimum(features.clearance_m(points), 3.0)
    assert np.allclose(features.clearance_up_to_m(points, 3.0), expected)
