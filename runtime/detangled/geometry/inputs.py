"""What compiled kernels are given: arrays of one kind, so that each kernel is compiled once."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, DTypeLike, NDArray


def compiled_input(values: ArrayLike, dtype: DTypeLike) -> NDArray:
    """The values as a contiguous, read-only array of a type, copied only where they are not yet.

    numba compiles a kernel anew for arrays that may be written to and arrays that may not; a groom's may not.
    """
    array = np.ascontiguousarray(values, dtype=dtype).view()
    array.flags.writeable = False
    return array
