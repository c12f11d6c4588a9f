"""Kernels over ranges on threads.

They release the GIL, and compile in half the time of numba's own parallel loops.
"""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor

import numba

CHUNKS_PER_THREAD = 16  # so that a thread that got the thin parts helps with the thick ones


def spread(work: Callable[[int, int], object], count: int) -> None:
    """Call ``work(begin, end)`` for ranges that make up 0 to ``count``, on as many threads as numba may use.

    What the calls write must not overlap; then the result does not depend on the number of threads.
    """
    threads = numba.get_num_threads()
    chunks = max(1, min(count, threads * CHUNKS_PER_THREAD if threads > 1 else 1))
    edges = [count * k // chunks for k in range(chunks + 1)]
    if chunks == 1:
        work(0, count)
        return
    with ThreadPoolExecutor(max_workers=threads) as pool:
        list(pool.map(work, edges[:-1], edges[1:]))
