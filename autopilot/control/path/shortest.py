"""Single-source shortest paths on a graph: Dijkstra's algorithm of scipy.

scipy is imported on first use: a controller that never needs a detour starts a third of a second sooner and needs 30
MB less.
"""

import importlib

import numpy as np
from numpy.typing import NDArray

from autopilot.core.frames import FloatArray


def lengths_from(
    node: int, begin: NDArray[np.intp], end: NDArray[np.intp], length: FloatArray, count: int
) -> tuple[FloatArray, NDArray[np.int32]]:
    """Length (count,) of the shortest path from ``node`` to every node, inf where there is none, and the predecessor
    on that path (count,), negative where there is none. Edges (m,) lead from ``begin`` to ``end``, without duplicates.
    """
    from scipy.sparse import csr_matrix
    from scipy.sparse.csgraph import dijkstra

    graph = csr_matrix((length, (begin, end)), shape=(count, count))
    found, before = dijkstra(graph, directed=True, indices=[node], return_predecessors=True)
    return found[0], before[0]


def warm() -> None:
    """Import scipy's parts for graphs and nearest places now."""
    for part in ("sparse.csgraph", "spatial"):
        importlib.import_module(f"scipy.{part}")
