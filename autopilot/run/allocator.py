"""How the C library's allocator keeps what is freed.

glibc learns from what is freed: a block of some megabytes that has been given back once is from then on taken out of a
heap, of which every thread has one. There small blocks that live on lie behind large ones that are gone, and the heaps
are never handed back: a process that holds 40 MB comes to take 600. With a fixed limit a large block is a mapping of
its own, and goes back to the system when it is freed; so does the end of a heap, beyond what is soon wanted again.
"""

import ctypes

LARGE_BYTES = 1 << 20
"""Blocks from here on are mappings of their own; a mapping costs some microseconds."""

KEPT_BYTES = 16 << 20
"""Free memory at the end of a heap is kept up to here. IPOPT takes and gives back some megabytes hundreds of times in a
plan; each time the system would have to clear their pages anew, a sixth of the plan's time."""

_M_TRIM_THRESHOLD, _M_MMAP_THRESHOLD = -1, -3
"""mallopt's, of glibc's malloc.h."""


def give_back_large_blocks() -> None:
    """For the whole process, from now on. Nothing happens where the C library is another one."""
    library = ctypes.CDLL(None)
    if hasattr(library, "gnu_get_libc_version"):
        library.mallopt(_M_MMAP_THRESHOLD, LARGE_BYTES)
        library.mallopt(_M_TRIM_THRESHOLD, KEPT_BYTES)
        library.malloc_trim(0)
