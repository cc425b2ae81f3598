"""Readers of current maps: numpy ``.npz``, NetCDF-3, and NetCDF-4 / HDF5 (extra ``currents``).

Returns the file's variables with dimensions and attributes, packed values unpacked, fill values NaN. Their
interpretation: :mod:`autopilot.control.current.map_reading`.
"""

import zipfile
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from autopilot.core.errors import ConfigError
from autopilot.core.frames import FloatArray

NETCDF3_MAGIC = (b"CDF\x01", b"CDF\x02")
"""Classic and 64-bit offset (NetCDF file format specification)."""

HDF5_MAGIC = b"\x89HDF"
"""HDF5 file format specification, superblock."""

ZIP_MAGIC = b"PK"
"""``.npz`` is a zip archive of ``.npy`` files."""

ATTRIBUTES = ("units", "positive", "_FillValue", "missing_value", "scale_factor", "add_offset")
"""What is looked at (NetCDF User Guide, attribute conventions; CF conventions 3.1 and 4.3)."""

MAX_VALUES = 50_000_000
"""Largest variable that is read (400 MB as doubles): a mistaken file must not eat the memory."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Variable:
    values: FloatArray
    """Unpacked (scale_factor, add_offset); _FillValue and missing_value are NaN."""
    dimensions: tuple[str, ...]
    """Names of its axes; empty when the format has none (``.npz``)."""
    attributes: Mapping[str, str]
    """Text attributes (units, positive, ...)."""


def read_variables(path: Path) -> dict[str, Variable]:
    """Every numeric variable of a file, by name. ConfigError if it cannot be read as any of the formats."""
    try:
        with path.open("rb") as file:
            magic = file.read(4)
    except OSError as error:
        raise ConfigError(f"current map {path}: cannot be read ({error.strerror}); correct the path") from error
    if magic.startswith(ZIP_MAGIC):
        return _read_npz(path)
    if magic in NETCDF3_MAGIC:
        return _read_netcdf3(path)
    if magic == HDF5_MAGIC:
        return _read_hdf5(path)
    raise ConfigError(f"current map {path}: neither .npz nor NetCDF-3 nor NetCDF-4/HDF5; convert it to one of them")


def _read_npz(path: Path) -> dict[str, Variable]:
    try:
        # numpy does not close a damaged archive.
        with path.open("rb") as raw, np.load(raw, allow_pickle=False) as archive:
            arrays = {name: archive[name] for name in archive.files}
    except (OSError, ValueError, EOFError, zipfile.BadZipFile) as error:
        raise _damaged(path, error) from error
    return {
        name: Variable(values=_unpacked(array, {}, path, name), dimensions=(), attributes={})
        for name, array in arrays.items()
        if array.dtype.kind in "iuf"
    }


def _read_netcdf3(path: Path) -> dict[str, Variable]:
    from scipy.io import netcdf_file

    try:
        # Without mmap nothing of the file is referred to once it is closed. Of a damaged one scipy closes nothing.
        with path.open("rb") as raw, netcdf_file(raw, "r", mmap=False) as file:
            return {
                # scipy keeps the attributes of the file as attributes of the object.
                name: _variable(
                    path,
                    name,
                    np.array(v.data),
                    tuple(v.dimensions),
                    {key: getattr(v, key) for key in ATTRIBUTES if hasattr(v, key)},
                )
                for name, v in file.variables.items()
                if np.asarray(v.data).dtype.kind in "iuf"
            }
    except (OSError, ValueError, TypeError, IndexError, KeyError, EOFError) as error:
        raise _damaged(path, error) from error


def _read_hdf5(path: Path) -> dict[str, Variable]:
    try:
        import h5netcdf
    except ImportError as error:
        raise ConfigError(
            f"current map {path}: NetCDF-4/HDF5 needs the extra: pip install 'underwater-autopilot[currents]',"
            " or convert the file to NetCDF-3 or .npz"
        ) from error
    try:
        with h5netcdf.File(str(path), "r", phony_dims="sort") as file:
            return {
                name: _variable(
                    path, name, np.asarray(v[...]), tuple(v.dimensions), {key: v.attrs[key] for key in v.attrs}
                )
                for name, v in file.variables.items()
                if v.dtype.kind in "iuf"
            }
    except (OSError, ValueError, TypeError, KeyError, RuntimeError) as error:
        raise _damaged(path, error) from error


def _damaged(path: Path, error: Exception) -> ConfigError:
    text = " ".join(str(error).split()) or type(error).__name__
    return ConfigError(f"current map {path}: damaged ({text}); copy or make it again")


def _variable(path: Path, name: str, raw: Any, dimensions: tuple[str, ...], attributes: dict[str, Any]) -> Variable:
    return Variable(
        values=_unpacked(raw, attributes, path, name),
        dimensions=dimensions,
        attributes={key: _text(value) for key, value in attributes.items()},
    )


def _unpacked(raw: Any, attributes: Mapping[str, Any], path: Path, name: str) -> FloatArray:
    """Doubles with fill values as NaN, then scale and offset (NetCDF User Guide, attribute conventions)."""
    if raw.size > MAX_VALUES:
        raise ConfigError(f"current map {path}: `{name}` has {raw.size} values, {MAX_VALUES} fit; cut out the region")
    values: FloatArray = np.array(raw, dtype=np.float64)
    for key in ("_FillValue", "missing_value"):
        for fill in np.atleast_1d(attributes.get(key, ())):
            # Compared in the type of the file: a fill value of 1.2676506e30f is not the same number as a double.
            values[np.asarray(raw == np.asarray(fill).astype(raw.dtype))] = np.nan
    values *= float(np.ravel(attributes.get("scale_factor", 1.0))[0])
    values += float(np.ravel(attributes.get("add_offset", 0.0))[0])
    return values


def _text(value: Any) -> str:
    return value.decode("utf-8", "replace") if isinstance(value, bytes) else str(value)
