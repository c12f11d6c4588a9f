"""What training stands on beside the runtime: torch and onnx, which the extra ``train`` installs."""

from __future__ import annotations


def load(threads: int | None) -> None:
    """Load both, torch on so many threads, or its own choice. Raises ModuleNotFoundError where one is missing."""
    import onnx  # noqa: F401
    import torch

    if threads is not None:
        torch.set_num_threads(threads)
