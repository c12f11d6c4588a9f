"""The processes that train together: one, or as many as torchrun started."""

from __future__ import annotations

import os
from collections.abc import Iterable

import torch
from torch import Tensor, distributed, nn

from detangled.errors import DetangledError


class Processes:
    """This process's place among them, and the device that it works on: a GPU where there is one.

    part: its part of a batch. Raises DetangledError where they cannot share the batch evenly.
    """

    def __init__(self, batch: int) -> None:
        self.rank, self.world = int(os.environ.get("RANK", "0")), int(os.environ.get("WORLD_SIZE", "1"))
        if batch % self.world:
            raise DetangledError(f"a batch of {batch} cannot be shared by {self.world} processes evenly")
        size = batch // self.world
        self.part = slice(self.rank * size, (self.rank + 1) * size)
        self.on_gpu = torch.cuda.is_available()
        own = int(os.environ.get("LOCAL_RANK", "0"))
        self.device = torch.device("cuda", own) if self.on_gpu else torch.device("cpu")
        if self.world > 1 and not distributed.is_initialized():
            distributed.init_process_group("nccl" if self.on_gpu else "gloo")

    @property
    def device_name(self) -> str:
        return torch.cuda.get_device_name() if self.on_gpu else "CPU"

    def average(self, parameters: Iterable[nn.Parameter], loss: Tensor) -> None:
        """Replace the gradients, and the loss, by their means over all processes."""
        if self.world == 1:
            return
        for tensor in [p.grad for p in parameters if p.grad is not None] + [loss.detach()]:
            distributed.all_reduce(tensor)
            tensor /= self.world

    def close(self) -> None:
        """Part from the others, where there are any."""
        if distributed.is_initialized():
            distributed.destroy_process_group()
