"""A denoiser's training so small that it takes a moment, and strands to train it on."""

from __future__ import annotations

import functools
from pathlib import Path

from detangled_training.dataset import write_dataset
from detangled_training.denoiser_training import TrainingOptions
from detangled_training.unet import Architecture
from detangled_training.variants import VariantOptions

TINY = Architecture(channels=(8, 16), attention=1, embedding=16, groups=4, heads=2)
STEPS, EVALUATE_EVERY, SAVE_EVERY = 6, 3, 2
tiny_options = functools.partial(
    TrainingOptions,
    steps=STEPS,
    batch=4,
    warm_up=2,
    evaluate_every=EVALUATE_EVERY,
    save_every=SAVE_EVERY,
    architecture=TINY,
)


def write_strands(folder: Path) -> Path:
    """A data set of a few signals, of 16 cells each."""
    write_dataset(folder, 42, 0, VariantOptions(cells=16, read_share=0.0), workers=1)
    return folder
