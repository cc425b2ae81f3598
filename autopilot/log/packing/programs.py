"""Unsolved QPs as attachments of a log: packing and unpacking, bit-exact."""

import io
import zipfile

import numpy as np

from autopilot.core.errors import LogError
from autopilot.core.messages import SolveStatus, UnsolvedProgram

NAME = "program-{:02d}.npz"
"""Of the attachments, counted from 1."""

_HEAD = ("t_us", "solver", "status")


def pack(program: UnsolvedProgram) -> bytes:
    """As a compressed npz file."""
    file = io.BytesIO()
    head = {"t_us": np.int64(program.t_us), "solver": np.array(program.solver), "status": np.int64(program.status)}
    np.savez_compressed(file, **head, **program.arrays)  # type: ignore[arg-type]
    return file.getvalue()


def unpack(name: str, data: bytes) -> UnsolvedProgram:
    """From an attachment. LogError if it is damaged."""
    try:
        with np.load(io.BytesIO(data)) as file:
            content = {key: file[key] for key in file.files}
        head = [content.pop(key).item() for key in _HEAD]
        return UnsolvedProgram(t_us=head[0], solver=str(head[1]), status=SolveStatus(head[2]), arrays=content)
    except (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile) as error:
        raise LogError(f"attachment {name} cannot be read ({type(error).__name__}: {error}); it is damaged") from None
