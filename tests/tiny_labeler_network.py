"""Labelers of the real kind, but of few weights: what tests of the networks and of their export work on."""

from __future__ import annotations

import torch

from detangled_training.labeler import Labeler, LabelerSizes

TINY = LabelerSizes(lstm_width=4, encoder_width=8, layers=1, heads=2, feed_forward=8)


def tiny_labeler(seed: int = 0) -> Labeler:
    """Labelers none of whose parameters is zero, as trained ones, with nothing that drops out."""
    torch.manual_seed(seed)
    network = Labeler(TINY)
    with torch.no_grad():
        for parameter in network.parameters():
            parameter += 0.2 * torch.randn_like(parameter)
    return network.eval().requires_grad_(False)
