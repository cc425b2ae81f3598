"""Settings of the C library's allocator that return freed memory to the system.

glibc raises its mmap threshold dynamically: after a block of some megabytes has been freed once, such blocks are
taken from a heap, one per thread. There long-lived small blocks lie behind freed large ones, and the heaps are
never returned: a process that holds 40 MB grows to 600 MB. With a fixed threshold a large block is a mapping of its
own, and is returned when it is freed; so is the top of a heap beyond the trim threshold.
"""

import ctypes

LARGE_BYTES = 1 << 20
"""Blocks from here on are mappings of their own; a mapping costs some microseconds."""

KEPT_BYTES = 16 << 20
"""Trim threshold of a heap. IPOPT allocates and frees some megabytes hundreds of times in a plan; each time the
system would have to clear their pages again, a sixth of the plan's time."""

_M_TRIM_THRESHOLD, _M_MMAP_THRESHOLD = -1, -3
"""mallopt's, of glibc's malloc.h."""


def give_back_large_blocks() -> None:
    """For the whole process, from now on. Nothing happens where the C library is another one."""
    library = ctypes.CDLL(None)
    if hasattr(library, "gnu_get_libc_version"):
        library.mallopt(_M_MMAP_THRESHOLD, LARGE_BYTES)
        library.mallopt(_M_TRIM_THRESHOLD, KEPT_BYTES)
        library.malloc_trim(0)
