"""How the C library holds the memory of a training process, which it takes and frees all the time.

All of it is glibc's on Linux; elsewhere nothing is done.
"""

import ctypes
import mmap
import sys
from typing import Any

TRIM_THRESHOLD, MMAP_THRESHOLD, LARGEST_FAST_BIN = -1, -3, 1  # of glibc's mallopt
LARGEST_OF_HEAP = 2**25  # bytes: the largest threshold that is accepted
HEAP = 2**29  # bytes of addresses: more than an update with all its weights takes
PIECE = 2**24  # bytes, of which the heap is filled once


def settle_memory() -> None:
    """Let the process keep what it freed, and hold it in pages of megabytes where it can.

    An update frees some megabytes and takes them again at once; given back to the system, they
    return page by page, which took a third of an update where it was measured. It walks through
    tens of megabytes, too: of pages of 4 kB these are more than the processor knows by heart. And
    what is freed in small pieces is joined at once, not whenever a large block is asked for.
    """
    libc = _libc()
    if libc is None:
        return
    libc.mallopt(TRIM_THRESHOLD, 2**31 - 1)
    libc.mallopt(MMAP_THRESHOLD, LARGEST_OF_HEAP)
    libc.mallopt(LARGEST_FAST_BIN, 0)
    _ask_for_huge_pages(libc)


def _libc() -> Any:
    library = ctypes.CDLL(None) if sys.platform.startswith("linux") else None
    return library if hasattr(library, "mallopt") else None


def _ask_for_huge_pages(libc: Any) -> None:
    """Grow the heap, touching none of it, and advise the system on it before it is used."""
    libc.malloc.restype = ctypes.c_void_p
    libc.malloc.argtypes = [ctypes.c_size_t]
    libc.free.argtypes = [ctypes.c_void_p]
    libc.madvise.argtypes = [ctypes.c_void_p, ctypes.c_size_t, ctypes.c_int]
    pieces = [libc.malloc(PIECE) for _ in range(HEAP // PIECE)]
    for start in filter(None, pieces):
        first_page = start - start % mmap.PAGESIZE
        libc.madvise(first_page, PIECE + mmap.PAGESIZE, mmap.MADV_HUGEPAGE)
    for start in pieces:
        libc.free(start)
