"""Table of a fixed-size topic: a numpy array with one row per message."""

import importlib
from collections.abc import Iterable, Iterator
from typing import Any, TypeAlias

import msgspec
import numpy as np

from autopilot.core.errors import LogError

Columns: TypeAlias = dict[str, Any]
"""Name -> one value per message."""


class MessageTable(np.ndarray[Any, np.dtype[np.void]]):
    """(n,) structured array: ``t_us`` (int64, service clock [us]), ``sequence``, then the fields without the header.

    Indexing by a field name gives a plain array, (n,) or (n, ...) for a field of fixed length.
    """

    def __getitem__(self, key: Any) -> Any:
        found: Any = super().__getitem__(key)
        return found.view(np.ndarray) if isinstance(key, str) else found

    def to_pandas(self) -> Any:
        """The table for pandas.

        Returns
        -------
        pandas.DataFrame
            Indexed by ``t_s`` [s]; arrays element by element (``pos_ned_m[0]``), nested fields by their path
            (``orientation.x``).

        Raises
        ------
        LogError
            pandas is not installed.
        """
        return data_frame(flat_columns(self))

    def to_xarray(self) -> Any:
        """The table for xarray.

        Returns
        -------
        xarray.Dataset
            Dimension ``t_s`` [s]; fields of fixed length keep their shape, with dimensions ``NAME_0``, ...; nested
            fields by their path (``orientation.x``).

        Raises
        ------
        LogError
            xarray is not installed.
        """
        xarray = _library("xarray")
        variables = {}
        for name, column in self._leaves():
            dimensions = ("t_s", *(f"{name}_{axis}" for axis in range(column.ndim - 1)))
            variables[name] = (
                dimensions,
                np.char.decode(column, errors="replace") if column.dtype.kind == "S" else column,
            )
        return xarray.Dataset(variables, coords={"t_s": self["t_us"] * 1e-6})

    def _leaves(self) -> Iterator[tuple[str, np.ndarray[Any, Any]]]:
        """Fields that are not tables themselves, with their path."""

        def below(name: str, column: np.ndarray[Any, Any]) -> Iterator[tuple[str, np.ndarray[Any, Any]]]:
            if column.dtype.names is None:
                yield name, column
            else:
                for inner in column.dtype.names:
                    yield from below(f"{name}.{inner}", column[inner])

        for name in self.dtype.names or ():
            yield from below(name, self[name])


def data_frame(columns: Columns) -> Any:
    """A pandas.DataFrame, indexed by ``t_s``. LogError if pandas is not installed."""
    return _library("pandas").DataFrame(columns).set_index("t_s")


def _library(name: str) -> Any:
    try:
        return importlib.import_module(name)
    except ImportError as error:
        raise LogError(f"to_{name}() needs {name}: pip install {name}; without it tables are numpy arrays") from error


def flat_columns(table: MessageTable) -> Columns:
    """Columns of a fixed-size topic.

    Parameters
    ----------
    table
        (n,) one row per message.

    Returns
    -------
    dict
        Name -> (n,) values: ``t_us`` [us], ``t_s`` [s], then the fields; arrays element by element
        (``pos_ned_m[0]``), nested fields by their path (``orientation.x``).
    """
    columns: Columns = {"t_us": table["t_us"], "t_s": table["t_us"] * 1e-6}
    for name in (table.dtype.names or ())[1:]:
        columns.update(_flat(name, table[name]))
    return columns


def _flat(name: str, column: np.ndarray[Any, Any]) -> Iterator[tuple[str, Any]]:
    """One field's columns; a text of fixed size as text."""
    for place in np.ndindex(*column.shape[1:]):
        element, label = column[(slice(None), *place)], name + "".join(f"[{index}]" for index in place)
        if element.dtype.names is not None:
            for inner in element.dtype.names:
                yield from _flat(f"{label}.{inner}", element[inner])
        elif element.dtype.kind == "S":
            yield label, [text.decode(errors="replace") for text in element.tolist()]
        else:
            yield label, element


def columns_of_values(t_us: np.ndarray[Any, Any], values: Iterable[Any]) -> Columns:
    """The same of decoded messages of variable size: their lists as JSON, bytes as their length."""
    rows = [dict(_value_leaves("", value)) for value in values]
    names = dict.fromkeys(name for row in rows for name in row)
    return {"t_us": t_us, "t_s": t_us * 1e-6, **{name: [row.get(name) for row in rows] for name in names}}


def _value_leaves(path: str, value: Any) -> Iterator[tuple[str, Any]]:
    """Numbers and texts of a message by their paths; what is no single value as JSON."""
    if isinstance(value, dict):
        for name, inner in value.items():
            yield from _value_leaves(f"{path}.{name}".lstrip("."), inner)
    elif isinstance(value, bool | int | float | str):
        yield path, value
    else:
        yield path, msgspec.json.encode(value, enc_hook=_plain).decode()


def _plain(value: object) -> object:
    """``enc_hook``: bytes as their length, arrays as lists."""
    if isinstance(value, bytes | bytearray | memoryview):
        return f"{len(value)} bytes"
    if isinstance(value, np.ndarray | np.generic):
        return value.tolist()
    raise NotImplementedError(type(value))
