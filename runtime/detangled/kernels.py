"""How numba kernels are compiled and cached: one cache for each version of the sources.

numba keys its cache on the file of the compiled function alone, so an edit to a function that it calls would go
unnoticed; and a package folder may be read-only. So the cache lives in the user's cache folder, in a directory
named by a hash of the sources that hold kernels, unless NUMBA_CACHE_DIR says otherwise.
"""

from __future__ import annotations

import hashlib
import importlib.util
import os
import sys
from importlib import import_module
from pathlib import Path
from typing import Any


def _user_cache() -> Path:
    if sys.platform == "win32":
        return Path(os.environ.get("LOCALAPPDATA", Path.home() / "AppData" / "Local"))
    if sys.platform == "darwin":
        return Path.home() / "Library" / "Caches"
    return Path(os.environ.get("XDG_CACHE_HOME", Path.home() / ".cache"))


def cache_directory() -> Path:
    """Where the compiled kernels of this version of detangled are kept."""
    if "NUMBA_CACHE_DIR" in os.environ:
        return Path(os.environ["NUMBA_CACHE_DIR"])
    packages = [Path(__file__).parent]
    # Kernels for training, where they are installed, call these and each other; they are looked for, not loaded.
    training = importlib.util.find_spec("detangled_training")
    if training is not None and training.submodule_search_locations:
        packages.extend(Path(folder) for folder in training.submodule_search_locations)
    digest = hashlib.sha256()
    for source in sorted(source for package in packages for source in package.rglob("*.py")):
        text = source.read_bytes()
        if b"detangled.kernels" in text:
            digest.update(text)
    return _user_cache() / "detangled" / f"kernels-{digest.hexdigest()[:16]}"


def is_first_run(kernel_name: str) -> bool:
    """Whether a kernel (``package.module.function``) is not compiled as it stands, so that its verb will take a while.

    Other copies of detangled may share the cache: theirs are in folders of their own.
    """
    module, _, name = kernel_name.rpartition(".")
    found = getattr(import_module(module), name)
    if not hasattr(found, "stats"):
        return False  # nothing is compiled where numba is told not to (NUMBA_DISABLE_JIT)
    source = found.py_func.__code__
    index = f"{Path(source.co_filename).stem}.{name}-{source.co_firstlineno}.*nbi"
    written = Path(source.co_filename).stat().st_mtime
    return all(path.stat().st_mtime < written for path in Path(found.stats.cache_path).glob(index))


os.environ.setdefault("NUMBA_CACHE_DIR", str(cache_directory()))

import numba  # noqa: E402  (its cache folder is read when it is imported)

prange = numba.prange
_threads_at_most = numba.get_num_threads()


def kernel(function: Any) -> Any:
    """Compile a function of one strand, called from other kernels."""
    return numba.njit(function, cache=True, error_model="numpy", nogil=True)


def inlined_kernel(function: Any) -> Any:
    """Like ``kernel``, but put into its callers whole: what one of them drops of several results costs it nothing."""
    return numba.njit(function, error_model="numpy", nogil=True, inline="always")


def vector_kernel(function: Any) -> Any:
    """Compile a function of finite numbers like ``kernel``, free to reorder sums for vector instructions."""
    return numba.njit(function, cache=True, error_model="numpy", nogil=True, fastmath=True)


def parallel_kernel(function: Any) -> Any:
    """Compile a function that runs over strands on all threads (``prange``)."""
    return numba.njit(function, cache=True, error_model="numpy", parallel=True, nogil=True)


def set_threads(count: int | None) -> None:
    """Use ``count`` threads from now on; None leaves numba's own choice, all cores."""
    if count is not None:
        numba.set_num_threads(max(1, min(count, _threads_at_most)))


def thread_count() -> int:
    """How many threads are in use."""
    return int(numba.get_num_threads())
