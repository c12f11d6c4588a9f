"""The colour of hair at one place, by its direction and the light that reaches it.

Kajiya and Kay's diffuse term and two highlights (1989), the second one coloured and both shifted along the
strand as Marschner et al. measured (2003), under a key light, a rim light and the sky (see lighting.py).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from detangled.kernels import kernel

DARK_BROWN = (0.062, 0.033, 0.020)  # linear reflectance of hair

# Strengths were set by eye on straight, coily and dense grooms, so that none is flat, black or washed out.
KEY_STRENGTH = 1.45
SKY_STRENGTH = 0.5
RIM_STRENGTH = 0.9
WHITE_STRENGTH = 1.1  # of the highlight reflected at the surface; nearly the light's own colour
COLOURED_STRENGTH = 7.5  # of the highlight that went through the hair and back
GLINT_STRENGTH = 0.5  # of the rim light caught at a strand's edge
EXPOSURE = 1.5
# A hair's scales tilt its surface: the white highlight moves towards the root, the coloured towards the tip.
WHITE_SHIFT, WHITE_EXPONENT = -0.07, 110.0
COLOURED_SHIFT, COLOURED_EXPONENT = 0.13, 22.0
SHIFT_JITTER = 0.06  # from strand to strand: one unbroken band of highlight looks like plastic
# Blue is lost first on the way through hair, so that its depths turn warm instead of black.
LOSS = (0.80, 1.0, 1.18)
OCCLUSION_CONTRAST = 1.5
SKIN = (0.36, 0.275, 0.235)  # linear reflectance of a head: a plain mannequin, lighter than most hair on it
SHEEN_STRENGTH, SHEEN_EXPONENT = 0.10, 24.0
INSIDE = 0.45  # of its light that the inside of an open mesh keeps
WRAP = 0.35  # light reaches this far past a strand's terminator, as it passes through


@dataclass(frozen=True)
class Look:
    """Colours of a picture, linear RGB.

    hair: reflectance. variation: standard deviation of the logarithm of a strand's brightness.
    sky_top, sky_bottom: the background's ends. skin: reflectance of a head.
    """

    hair: tuple[float, float, float] = DARK_BROWN
    variation: float = 0.22
    sky_top: tuple[float, float, float] = (0.74, 0.745, 0.755)
    sky_bottom: tuple[float, float, float] = (0.57, 0.57, 0.575)
    skin: tuple[float, float, float] = SKIN


def tints(ids: NDArray[np.int64], look: Look, colours: NDArray[np.floating] | None = None) -> NDArray[np.float32]:
    """Colour of each strand and a number that shifts its highlights, (n, 4), from nothing but its index.

    colours: linear RGB of every strand, (S, 3), which are kept to the number, in place of the look's.
    """
    noise = np.stack([_hash(ids, salt) for salt in range(3)], axis=1) - 0.5
    tint = np.empty((len(ids), 4), dtype=np.float32)
    brightness = np.exp(look.variation * np.sqrt(12.0) * noise[:, 0])
    warmth = 0.16 * noise[:, 1]
    tint[:, 0] = look.hair[0] * brightness * (1.0 + warmth)
    tint[:, 1] = look.hair[1] * brightness
    tint[:, 2] = look.hair[2] * brightness * (1.0 - warmth)
    tint[:, 3] = 2.0 * noise[:, 2]
    if colours is not None:
        tint[:, :3] = colours[ids]
    return tint


def _hash(ids: NDArray[np.int64], salt: int) -> NDArray[np.float64]:
    """A number in [0, 1) for each index (splitmix64's finaliser)."""
    x = ids.astype(np.uint64) * np.uint64(3) + np.uint64(salt + 1)
    x *= np.uint64(0x9E3779B97F4A7C15)
    x = (x ^ (x >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    x = (x ^ (x >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return ((x ^ (x >> np.uint64(31))) >> np.uint64(11)) / float(1 << 53)


@kernel
def _lobe(tx, ty, tz, nx, ny, nz, shift, hx, hy, hz, exponent):  # type: ignore[no-untyped-def]
    """Kajiya and Kay's highlight about the half vector h, the tangent tilted by ``shift`` to the normal."""
    x, y, z = tx + shift * nx, ty + shift * ny, tz + shift * nz
    dot = (x * hx + y * hy + z * hz) / np.sqrt(x * x + y * y + z * z)
    return np.exp(0.5 * exponent * np.log(max(1.0 - dot * dot, 1e-9)))


@kernel
def shade(px, py, pz, tx, ty, tz, u, tint, reach, view, key, rim, out):  # type: ignore[no-untyped-def]
    """Light that a place (px, py, pz) on a strand sends to the eye, linear RGB in [0, 1), into ``out``.

    t: unit tangent, root to tip. u: place across the ribbon, -1 to 1. tint: a row of ``tints``. reach: the
    place's values in a LightGrid. view: the camera (see curves.lens). key, rim: towards the lights.
    """
    if view[1] > 0.0:
        vx, vy, vz = view[2] - px, view[3] - py, view[4] + 1.0 / view[1] - pz
        norm = 1.0 / np.sqrt(vx * vx + vy * vy + vz * vz)
        vx, vy, vz = vx * norm, vy * norm, vz * norm
    else:
        vx, vy, vz = 0.0, 0.0, 1.0
    # Across the ribbon, and out of it towards the eye.
    sx, sy, sz = ty * vz - tz * vy, tz * vx - tx * vz, tx * vy - ty * vx
    norm = 1.0 / max(np.sqrt(sx * sx + sy * sy + sz * sz), 1e-6)
    sx, sy, sz = sx * norm, sy * norm, sz * norm
    ox, oy, oz = sy * tz - sz * ty, sz * tx - sx * tz, sx * ty - sy * tx
    bulge = np.sqrt(max(1.0 - u * u, 0.0))
    nx, ny, nz = bulge * ox + u * sx, bulge * oy + u * sy, bulge * oz + u * sz

    along = tx * key[0] + ty * key[1] + tz * key[2]
    facing = nx * key[0] + ny * key[1] + nz * key[2]
    diffuse = np.sqrt(max(1.0 - along * along, 0.0)) * (0.45 + 0.55 * max(0.0, (facing + WRAP) / (1.0 + WRAP)))
    hx, hy, hz = key[0] + vx, key[1] + vy, key[2] + vz
    norm = 1.0 / np.sqrt(hx * hx + hy * hy + hz * hz)
    hx, hy, hz = hx * norm, hy * norm, hz * norm
    rounded = 0.35 + 0.65 * max(0.0, nx * hx + ny * hy + nz * hz)
    jitter = SHIFT_JITTER * tint[3]
    white = rounded * _lobe(tx, ty, tz, ox, oy, oz, WHITE_SHIFT + jitter, hx, hy, hz, WHITE_EXPONENT)
    coloured = rounded * _lobe(tx, ty, tz, ox, oy, oz, COLOURED_SHIFT + jitter, hx, hy, hz, COLOURED_EXPONENT)

    along = tx * rim[0] + ty * rim[1] + tz * rim[2]
    edge = max(0.0, nx * rim[0] + ny * rim[1] + nz * rim[2])
    backlit = np.sqrt(max(1.0 - along * along, 0.0)) * (0.3 + 0.7 * edge)
    glint = GLINT_STRENGTH * backlit * backlit * edge
    sky = SKY_STRENGTH * (0.78 + 0.22 * ny)
    for c in range(3):
        lit = np.exp(-LOSS[c] * reach[0])
        behind = np.exp(-LOSS[c] * reach[1])
        open_sky = np.exp(OCCLUSION_CONTRAST * LOSS[c] * np.log(max(reach[2], 1e-3)))
        colour = tint[c]
        root = np.sqrt(colour)
        light = colour * (KEY_STRENGTH * lit * diffuse + sky * open_sky + RIM_STRENGTH * behind * backlit)
        light += lit * root * (WHITE_STRENGTH * white + COLOURED_STRENGTH * colour * coloured)
        light += root * behind * glint
        out[c] = 1.0 - np.exp(-EXPOSURE * light)


@kernel
def shade_surface(p, n, skin, reach, view, key, rim, out):  # type: ignore[no-untyped-def]
    """Light that a place p (3,) of normal n (3,) on a head sends to the eye, linear RGB in [0, 1), into ``out``.

    The rest as for ``shade``. A face seen from behind is the inside of an open mesh: darker, and lit from there.
    """
    vx, vy, vz = 0.0, 0.0, 1.0
    if view[1] > 0.0:
        vx, vy, vz = view[2] - p[0], view[3] - p[1], view[4] + 1.0 / view[1] - p[2]
        norm = 1.0 / np.sqrt(vx * vx + vy * vy + vz * vz)
        vx, vy, vz = vx * norm, vy * norm, vz * norm
    nx, ny, nz = n[0], n[1], n[2]
    kept = 1.0
    if nx * vx + ny * vy + nz * vz < 0.0:
        nx, ny, nz, kept = -nx, -ny, -nz, INSIDE
    facing = max(0.0, (nx * key[0] + ny * key[1] + nz * key[2] + 0.5 * WRAP) / (1.0 + 0.5 * WRAP))
    backlit = max(0.0, nx * rim[0] + ny * rim[1] + nz * rim[2])
    hx, hy, hz = key[0] + vx, key[1] + vy, key[2] + vz
    norm = 1.0 / max(np.sqrt(hx * hx + hy * hy + hz * hz), 1e-9)
    sheen = SHEEN_STRENGTH * max(0.0, (nx * hx + ny * hy + nz * hz) * norm) ** SHEEN_EXPONENT
    sky = SKY_STRENGTH * (0.74 + 0.26 * ny)
    for c in range(3):
        lit = np.exp(-LOSS[c] * reach[0])
        behind = np.exp(-LOSS[c] * reach[1])
        open_sky = np.exp(OCCLUSION_CONTRAST * LOSS[c] * np.log(max(reach[2], 1e-3)))
        light = skin[c] * (KEY_STRENGTH * lit * facing + sky * open_sky + RIM_STRENGTH * behind * backlit)
        out[c] = 1.0 - np.exp(-EXPOSURE * kept * (light + lit * facing * sheen))
