"""Pictures by path tracing, through Mitsuba 3 (Jakob et al. 2022): slower, and physically right.

Hair scatters light as in Chiang et al. (2016), Mitsuba's ``hair``; its absorption is that of the colour asked for
(see colours.py). Needs the package mitsuba.
"""

from __future__ import annotations

import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from detangled.errors import DetangledError
from detangled.kernels import thread_count
from detangled.view.camera import Camera
from detangled.view.colours import absorption_of
from detangled.view.curves import Curves, lens, trace
from detangled.view.lighting import KEY, RIM
from detangled.view.rasteriser import NARROWEST_PX, background, encoded
from detangled.view.shading import Look, tints
from detangled.view.surface import Surface

EXTRA = "path tracing needs mitsuba: pip install 'detangled[beauty]'"
VARIANT = "scalar_rgb"  # needs no LLVM on the machine; on a few cores others are no faster
GROUPS = 24  # colours told apart: each is a material of its own
DARK_DEPTH, LIGHT_DEPTH = 10, 24  # bounces: light hair passes light on through many strands
LIGHT_HAIR = 0.12  # reflectance from which hair is light
ROUGHNESS = 0.3
SCALE_TILT = 2.0  # degrees
# Strands are drawn wider and fewer than hairs are: light meets fewer on its way, so each takes more of it.
STRAND_ABSORPTION = 2.5
# Lights as the rasteriser has them, in its exposure; strengths set by eye so that both look alike.
KEY_LIGHT, RIM_LIGHT, SKY_LIGHT = 8.0, 5.5, 0.36
LAMP_PLACE, LAMP_SIZE = 4.0, 1.1  # distance and half side of a lamp, in the scene's radii
EXPOSURE = 1.0
PASS = 8  # samples of a pixel traced at once
BRIGHTEST_PASS = 2.0  # a few paths are so bright that they would stay as white dots: cut off in each pass


def load() -> Any:
    """Mitsuba, its variant chosen. Raises ModuleNotFoundError with what to install where it is absent."""
    try:
        import mitsuba
    except ImportError as error:
        raise ModuleNotFoundError(EXTRA) from error
    if VARIANT not in mitsuba.variants():
        raise DetangledError(f"mitsuba {mitsuba.__version__} was built without {VARIANT}, which path tracing needs")
    mitsuba.set_variant(VARIANT)
    mitsuba.set_log_level(mitsuba.LogLevel.Error)
    return mitsuba


def trace_paths(
    curves: Curves,
    camera: Camera,
    width: float,
    look: Look,
    samples: int,
    *,
    colours: NDArray[np.floating] | None = None,
    surface: Surface | None = None,
    progress: Callable[[int], object] | None = None,
) -> NDArray[np.uint8]:
    """The picture, (height, width, 3) sRGB, of strands ``width`` [cm] wide, with so many ``samples`` a pixel.

    colours, surface: as for the rasteriser's ``draw``. progress: told of finished samples.
    Raises ModuleNotFoundError where mitsuba is absent.
    """
    mitsuba = load()
    _use_threads()
    tint = tints(curves.ids, look, colours)[:, :3].astype(np.float64)
    light_hair = float(np.median(tint.max(axis=1))) > LIGHT_HAIR
    with tempfile.TemporaryDirectory() as folder:
        scene: dict[str, Any] = {
            "type": "scene",
            "integrator": {
                "type": "path",
                "max_depth": LIGHT_DEPTH if light_hair else DARK_DEPTH,
                "hide_emitters": True,
            },
            "sensor": _sensor(mitsuba, camera, samples),
            **_lights(mitsuba, curves, camera),
            **_strands(mitsuba, curves, camera, width, tint, Path(folder)),
        }
        if surface is not None:
            scene["head"] = _head(mitsuba, surface, look)
        loaded = mitsuba.load_dict(scene)
        film = _mean_of_passes(mitsuba, loaded, samples, progress)
    colour, alpha = np.maximum(film[..., :3], 0.0), np.clip(film[..., 3:4], 0.0, 1.0)
    linear = background(camera, look).astype(np.float64)
    foot = len(film)
    # The film holds premultiplied light; the curve is the rasteriser's, on what light there is where hair covers.
    seen = 1.0 - np.exp(-EXPOSURE * colour / np.maximum(alpha, 1e-4))
    linear[:foot] = (1.0 - alpha) * linear[:foot] + alpha * seen
    return encoded(linear)


def _mean_of_passes(
    mitsuba: Any, scene: Any, samples: int, progress: Callable[[int], object] | None
) -> NDArray[np.float64]:
    """Light and coverage, (height, width, 4), of a few samples at a time, each time by other random numbers."""
    total, done = np.zeros(()), 0
    while done < samples:
        count = min(PASS, samples - done)
        film = np.array(mitsuba.render(scene, spp=count, seed=done), dtype=np.float64)
        total = total + count * np.minimum(np.nan_to_num(film), BRIGHTEST_PASS)
        done += count
        if progress is not None:
            progress(count)
    return np.asarray(total / samples)


def _use_threads() -> None:
    import drjit

    drjit.set_thread_count(thread_count())


def _sensor(mitsuba: Any, camera: Camera, samples: int) -> dict[str, Any]:
    """The camera; what lies under the principal point's mirror image, a caption's foot, is not traced."""
    height = round(2.0 * camera.principal[1])
    eye, distance = np.asarray(camera.centre), 1.0 / max(camera.nearness, 1e-9)
    transform = mitsuba.ScalarTransform4f
    film = {
        "type": "hdrfilm",
        "width": camera.width,
        "height": height,
        "pixel_format": "rgba",
        "component_format": "float32",
        "filter": {"type": "gaussian"},
    }
    sampler = {"type": "independent", "sample_count": samples}
    if camera.nearness == 0.0:
        half = 0.5 * camera.width / camera.scale
        origin = eye + np.array([0.0, 0.0, 1e3])
        look_at = transform().look_at(origin=list(origin), target=list(eye), up=[0, 1, 0])
        to_world = look_at @ transform().scale([half, half, 1.0])
        return {"type": "orthographic", "to_world": to_world, "film": film, "sampler": sampler, "near_clip": 1e-2}
    origin = eye + np.array([0.0, 0.0, distance])
    return {
        "type": "perspective",
        "fov_axis": "x",
        "fov": float(np.degrees(2.0 * np.arctan(0.5 * camera.width / (camera.scale * distance)))),
        "near_clip": 1e-3 * distance,
        "far_clip": 1e3 * distance,
        "to_world": transform().look_at(origin=list(origin), target=list(eye), up=[0, 1, 0]),
        "film": film,
        "sampler": sampler,
    }


def _lights(mitsuba: Any, curves: Curves, camera: Camera) -> dict[str, Any]:
    """A key and a rim lamp where the rasteriser's lights are, and an even sky."""
    middle = np.asarray(camera.centre)
    radius = 0.5 * max(float(np.linalg.norm(curves.high - curves.low)), 1e-3)
    lights: dict[str, Any] = {"sky": {"type": "constant", "radiance": {"type": "rgb", "value": 3 * [SKY_LIGHT]}}}
    for name, towards, strength in (("key", KEY, KEY_LIGHT), ("rim", RIM, RIM_LIGHT)):
        place = middle + LAMP_PLACE * radius * towards
        turned = mitsuba.ScalarTransform4f().look_at(origin=list(place), target=list(middle), up=[0, 1, 0])
        # So large a lamp lights the hair as a distant light of the same strength would.
        radiance = strength * LAMP_PLACE**2 / (4.0 * LAMP_SIZE**2)
        lights[name] = {
            "type": "rectangle",
            "to_world": turned @ mitsuba.ScalarTransform4f().scale(LAMP_SIZE * radius),
            "emitter": {"type": "area", "radiance": {"type": "rgb", "value": 3 * [float(radiance)]}},
        }
    return lights


def _strands(
    mitsuba: Any, curves: Curves, camera: Camera, width: float, tint: NDArray[np.float64], folder: Path
) -> dict[str, Any]:
    """Strands as cubic B-splines, a shape for each group of like colours."""
    vertices, owners = trace(curves, lens(camera, 1), 1)
    radius = 0.5 * max(width, NARROWEST_PX / camera.scale)
    shapes: dict[str, Any] = {}
    group = _alike(tint)
    for number in np.unique(group):
        chosen = group[owners] == number
        path = folder / f"{number}.txt"
        _write(vertices[chosen].astype(np.float64), owners[chosen], radius, path)
        absorption = STRAND_ABSORPTION * absorption_of(tint[group == number].mean(axis=0))
        shapes[f"strands_{number}"] = {
            "type": "bsplinecurve",
            "filename": str(path),
            "bsdf": {
                "type": "hair",
                "sigma_a": {"type": "rgb", "value": [float(value) for value in absorption]},
                "longitudinal_roughness": ROUGHNESS,
                "azimuthal_roughness": ROUGHNESS,
                "scale_tilt": SCALE_TILT,
            },
        }
    return shapes


def _alike(tint: NDArray[np.float64]) -> NDArray[np.int64]:
    """Which of at most GROUPS groups of like colours each strand belongs to, (S,)."""
    distinct, group = np.unique(tint, axis=0, return_inverse=True)
    if len(distinct) <= GROUPS:
        return np.asarray(group.reshape(-1))
    # Split the group that is spread widest at the middle of its widest channel, as often as it takes.
    log = np.log(np.maximum(tint, 1e-4))
    group = np.zeros(len(tint), dtype=np.int64)
    for number in range(1, GROUPS):
        widths = [np.ptp(log[group == k], axis=0).max() * np.sqrt(np.sum(group == k)) for k in range(number)]
        widest = group == int(np.argmax(widths))
        channel = int(np.argmax(np.ptp(log[widest], axis=0)))
        middle = np.median(log[widest, channel])
        group[widest & (log[:, channel] > middle)] = number
    return group


def _write(vertices: NDArray[np.float64], owners: NDArray[np.int32], radius: float, path: Path) -> None:
    """Write control points, one more at either end: mirrored there, the spline begins and ends where hair does."""
    starts = np.flatnonzero(np.diff(owners, prepend=-1))
    ends = np.append(starts[1:], len(owners))
    with path.open("w", encoding="ascii") as file:
        for first, last in zip(starts, ends, strict=True):
            strand = vertices[first:last]
            whole = np.concatenate([2.0 * strand[:1] - strand[1:2], strand, 2.0 * strand[-1:] - strand[-2:-1]])
            file.writelines(f"{x:.6g} {y:.6g} {z:.6g} {radius:.6g}\n" for x, y, z in whole.tolist())
            file.write("\n")


def _head(mitsuba: Any, surface: Surface, look: Look) -> Any:
    skin = {
        "type": "twosided",
        "bsdf": {"type": "diffuse", "reflectance": {"type": "rgb", "value": [float(value) for value in look.skin]}},
    }
    properties = mitsuba.Properties()
    properties["bsdf"] = mitsuba.load_dict(skin)
    mesh = mitsuba.Mesh("head", len(surface.vertices), len(surface.faces), properties, has_vertex_normals=True)
    parameters = mitsuba.traverse(mesh)
    parameters["vertex_positions"] = surface.vertices.ravel()
    parameters["vertex_normals"] = surface.normals.ravel()
    parameters["faces"] = surface.faces.astype(np.uint32).ravel()
    parameters.update()
    return mesh
