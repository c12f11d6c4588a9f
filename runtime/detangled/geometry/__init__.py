"""Strand geometry: splines, frames, canonical space, centrelines, and the kappa-tau-v signal."""
