"""How the C library holds the memory of a training process, which it takes and frees all the time.

All of it is glibc's on Linux; elsewhere nothing is done.
"""

import ctypes
import mmap
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

TRIM_THRESHOLD, MMAP_THRESHOLD, LARGEST_FAST_BIN = -1, -3, 1  # of glibc's mallopt
LARGEST_OF_HEAP = 2**25  # bytes: the largest threshold that is accepted
USUAL_THRESHOLD, USUAL_FAST_BIN = 2**17, 16 * ctypes.sizeof(ctypes.c_size_t)  # glibc's own
HEAP = 2**29  # bytes of addresses: more than an update with all its weights takes
PIECE = 2**24  # bytes, of which the heap is filled once


@contextmanager
def memory_kept() -> Iterator[None]:
    """Let the process keep what it frees inside the block, in pages of megabytes where it can.

    An update frees some megabytes and takes them again at once; given back to the system, they
    return page by page, which took a third of an update where it was measured. It walks through
    tens of megabytes, too: of pages of 4 kB these are more than the processor knows by heart. And
    what is freed in small pieces is joined at once, not whenever a large block is requested.

    Behind the block the C library's usual thresholds hold again, and what is free goes back to the
    system. One thing does not come back: glibc no longer moves its threshold for large blocks by
    itself, once it was set.
    """
    libc = _libc()
    if libc is None:
        yield
        return
    libc.mallopt(TRIM_THRESHOLD, 2**31 - 1)
    libc.mallopt(MMAP_THRESHOLD, LARGEST_OF_HEAP)
    libc.mallopt(LARGEST_FAST_BIN, 0)
    pieces = _ask_for_huge_pages(libc)
    try:
        yield
    finally:
        _withdraw_huge_pages(libc, pieces)
        libc.mallopt(TRIM_THRESHOLD, USUAL_THRESHOLD)
        libc.mallopt(MMAP_THRESHOLD, USUAL_THRESHOLD)
        libc.mallopt(LARGEST_FAST_BIN, USUAL_FAST_BIN)
        libc.malloc_trim(0)


def _libc() -> Any:
    library = ctypes.CDLL(None) if sys.platform.startswith("linux") else None
    return library if hasattr(library, "mallopt") else None


def _ask_for_huge_pages(libc: Any) -> list[int]:
    """Grow the heap, touching none of it, and advise the system on it before it is used.

    Returns:
        Where each advised piece starts.
    """
    libc.malloc.restype = ctypes.c_void_p
    libc.malloc.argtypes = [ctypes.c_size_t]
    libc.free.argtypes = [ctypes.c_void_p]
    libc.madvise.argtypes = [ctypes.c_void_p, ctypes.c_size_t, ctypes.c_int]
    pieces = [piece for _ in range(HEAP // PIECE) if (piece := libc.malloc(PIECE)) is not None]
    _advise(libc, pieces, mmap.MADV_HUGEPAGE)
    for start in pieces:
        libc.free(start)
    return pieces


def _withdraw_huge_pages(libc: Any, pieces: list[int]) -> None:
    """Take the advice back: a page of megabytes stays in memory for the sake of its last byte."""
    _advise(libc, pieces, mmap.MADV_NOHUGEPAGE)


def _advise(libc: Any, pieces: list[int], advice: int) -> None:
    for start in pieces:
        first_page = start - start % mmap.PAGESIZE
        libc.madvise(first_page, PIECE + mmap.PAGESIZE, advice)
