"""Detangled: strand-based hair, measured, edited and generated on a CPU."""

from __future__ import annotations

__version__ = "0.1.0"
