"""A bound on the memory that reading a damaged file may take."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

_one_at_a_time = threading.Lock()


@contextmanager
def memory_limit(size: int) -> Iterator[None]:
    """Let the process grow by at most `size` bytes of address space in the block: beyond it MemoryError is raised.

    It protects against readers that trust the counts in a file: their allocations fail before memory is touched. A
    limit that the process has already is never raised. Linux only; without effect elsewhere.
    """
    try:
        import resource

        pages = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[0])
    except (ImportError, OSError, ValueError):
        yield
        return
    with _one_at_a_time:
        soft, hard = resource.getrlimit(resource.RLIMIT_AS)
        wish = pages * resource.getpagesize() + size
        known = [limit for limit in (soft, hard) if limit != resource.RLIM_INFINITY]
        resource.setrlimit(resource.RLIMIT_AS, (min([wish, *known]), hard))
        try:
            yield
        finally:
            resource.setrlimit(resource.RLIMIT_AS, (soft, hard))
