"""What can go wrong, by what the caller can do about it. Each class carries its command-line exit code."""

from __future__ import annotations


class DetangledError(Exception):
    """Base of every error that detangled raises on purpose; its text is one clear sentence for a person."""

    exit_code = 3


class ReadError(DetangledError):
    """An input could not be read, or holds nothing that can be used."""

    exit_code = 3


class TextureError(DetangledError):
    """A texture, or the strands meant to define one, cannot be used."""

    exit_code = 3


class ModelError(DetangledError):
    """A model or fitted texture is damaged or of another version."""

    exit_code = 4


class WriteError(DetangledError):
    """An output could not be written."""

    exit_code = 5
