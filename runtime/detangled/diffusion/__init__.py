"""The sampler and what predicts the clean signal for it."""
