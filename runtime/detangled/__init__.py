"""Detangled: strand-based hair, measured, edited and generated on a CPU.

The Python API says what the command line says: ``read`` a groom, ``label`` its strands, ``fit`` a texture to a few or
ask for one by numbers (``asked_texture``), ``retexture`` the groom with it or ``generate`` strands of it, ``write`` the
result. Each is loaded when first used.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from detangled.fitted import load_texture, save_texture
    from detangled.fitting import fit
    from detangled.formats import read, write
    from detangled.from_numbers import asked, asked_texture
    from detangled.generation import generate
    from detangled.groom import Attribute, Groom, Scope
    from detangled.grooming.guides import guides_groom as guides
    from detangled.grooming.lengths import Length
    from detangled.labeling import Labels, label
    from detangled.retexturing import Options, Result, retexture
    from detangled.texture import Profile, hair_type

__version__ = "0.1.0"

_WHERE = {
    "Attribute": ("detangled.groom", "Attribute"),
    "Groom": ("detangled.groom", "Groom"),
    "Scope": ("detangled.groom", "Scope"),
    "read": ("detangled.formats", "read"),
    "write": ("detangled.formats", "write"),
    "fit": ("detangled.fitting", "fit"),
    "asked": ("detangled.from_numbers", "asked"),
    "asked_texture": ("detangled.from_numbers", "asked_texture"),
    "generate": ("detangled.generation", "generate"),
    "save_texture": ("detangled.fitted", "save_texture"),
    "load_texture": ("detangled.fitted", "load_texture"),
    "Profile": ("detangled.texture", "Profile"),
    "hair_type": ("detangled.texture", "hair_type"),
    "label": ("detangled.labeling", "label"),
    "Labels": ("detangled.labeling", "Labels"),
    "guides": ("detangled.grooming.guides", "guides_groom"),
    "retexture": ("detangled.retexturing", "retexture"),
    "Length": ("detangled.grooming.lengths", "Length"),
    "Options": ("detangled.retexturing", "Options"),
    "Result": ("detangled.retexturing", "Result"),
}

__all__ = [
    "Attribute",
    "Groom",
    "Labels",
    "Length",
    "Options",
    "Profile",
    "Result",
    "Scope",
    "__version__",
    "asked",
    "asked_texture",
    "fit",
    "generate",
    "guides",
    "hair_type",
    "label",
    "load_texture",
    "read",
    "retexture",
    "save_texture",
    "write",
]


def __getattr__(name: str) -> Any:
    if name not in _WHERE:
        raise AttributeError(f"module 'detangled' has no attribute {name!r}")
    module, attribute = _WHERE[name]
    return getattr(import_module(module), attribute)
