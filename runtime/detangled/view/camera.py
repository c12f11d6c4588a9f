"""A camera that frames what it is given. Camera axes: x right, y up in the picture, z towards the viewer."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from detangled.errors import DetangledError

# Azimuth and elevation of the viewer [degrees], counted from the front: +90 looks at the head's left side.
VIEWS = {
    "front": (0.0, 0.0),
    "side": (90.0, 0.0),
    "back": (180.0, 0.0),
    "top": (0.0, 90.0),
    "34": (40.0, 14.0),
}

# Rows: the groom's axes that become right, up and front of an upright head. Blender's heads look along -y and
# become +z when it exports them with y up, so the same head has the same front either way.
_UPRIGHT = {
    "y": np.array([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]),
    "z": np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]]),
    "x": np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]),
}

FIELD_OF_VIEW = 26.0  # degrees over the picture's shorter side: a portrait lens, so that proportions hold
MARGIN = 0.06  # of the picture's shorter side, left free on every side
SMALLEST_EXTENT_CM = 0.01  # a single short strand is framed as if it were at least this large


@dataclass(frozen=True)
class Camera:
    """Where a point in camera axes lands in a picture.

    A point (x, y, z) [cm] is drawn at the pixel
    ``principal + scale * (x - centre_x, centre_y - y) / (1 - nearness * (z - centre_z))``.

    scale: pixels per cm at the depth ``centre[2]``.
    nearness: 1 / distance of the eye from that depth [1/cm]; 0 for an orthographic camera.
    """

    width: int
    height: int
    scale: float
    nearness: float
    centre: tuple[float, float, float]
    principal: tuple[float, float]

    def project(self, points: NDArray[np.floating]) -> NDArray[np.float64]:
        """Pixels (x to the right, y downwards; the first pixel spans 0 to 1), (n, 2), of points (n, 3)."""
        offset = np.asarray(points, dtype=np.float64) - np.asarray(self.centre)
        factor = self.scale / (1.0 - self.nearness * offset[:, 2])
        return np.stack([self.principal[0] + factor * offset[:, 0], self.principal[1] - factor * offset[:, 1]], axis=1)


def view_rotation(view: str, up: str) -> NDArray[np.float64]:
    """Rows right, up and towards the viewer, (3, 3), in the axes of a groom whose ``up`` axis points up.

    Raises DetangledError for a view or axis that is not known.
    """
    return view_turn(view) @ upright(up)


def upright(up: str) -> NDArray[np.float64]:
    """Rows right, up and front of an upright head, (3, 3), in the axes of a groom whose ``up`` axis points up."""
    if up not in _UPRIGHT:
        raise DetangledError(f"unknown up axis {up!r}: use one of {', '.join(_UPRIGHT)}")
    return _UPRIGHT[up].copy()


def view_turn(view: str, further: float = 0.0) -> NDArray[np.float64]:
    """Rows right, up and towards the viewer, (3, 3), in the axes of an upright head.

    further: degrees that the viewer has gone on around the head, to its left side first.
    """
    if view not in VIEWS:
        raise DetangledError(f"unknown view {view!r}: use one of {', '.join(VIEWS)}")
    azimuth, elevation = np.radians(np.add(VIEWS[view], (further, 0.0)))
    ca, sa, ce, se = np.cos(azimuth), np.sin(azimuth), np.cos(elevation), np.sin(elevation)
    return np.array([[ca, 0.0, -sa], [-se * sa, ce, -se * ca], [ce * sa, se, ce * ca]])


def frame(
    clouds: Sequence[NDArray[np.floating]],
    size: tuple[int, int],
    *,
    perspective: bool = True,
    foot: int = 0,
) -> Camera:
    """The nearest camera whose picture of ``size`` (width, height) shows every point of all clouds.

    clouds: (n, 3) arrays of finite points in camera axes [cm], none of them empty.
    foot: pixels at the bottom kept free for a caption.
    """
    width, height = size
    free = MARGIN * min(width, height)
    half_width, half_height = 0.5 * width - free, 0.5 * (height - foot) - free
    if min(half_width, half_height) < 1.0:
        raise DetangledError(f"a picture of {width} x {height} pixels is too small to show hair")
    low = np.array([min(float(cloud[:, axis].min()) for cloud in clouds) for axis in range(3)])
    high = np.array([max(float(cloud[:, axis].max()) for cloud in clouds) for axis in range(3)])
    middle = 0.5 * (low + high)
    extent = max(float(np.max(high - low)), SMALLEST_EXTENT_CM)
    principal = (0.5 * width, 0.5 * (height - foot))
    if not perspective:
        span = np.maximum(high - low, 1e-3 * extent)
        scale = min(2.0 * half_width / span[0], 2.0 * half_height / span[1])
        return Camera(width, height, float(scale), 0.0, _triple(middle), principal)

    # Each point bounds the eye's place by a plane on each side of the frustum: right, left, top, bottom.
    focal = 0.5 * min(width, height) / np.tan(np.radians(0.5 * FIELD_OF_VIEW))
    slope = np.array([half_width, half_height]) / focal
    sides = [(1.0, 0.0, slope[0]), (-1.0, 0.0, slope[0]), (0.0, 1.0, slope[1]), (0.0, -1.0, slope[1])]
    bounds = np.array([max(_farthest(cloud, side) for cloud in clouds) - middle @ side for side in sides])
    eye = middle[:2] + 0.5 * (bounds[0::2] - bounds[1::2])
    distance = float(high[2] - middle[2]) + 0.5 * extent
    distance = max(distance, *(0.5 * (bounds[0::2] + bounds[1::2]) / slope))
    centre = (float(eye[0]), float(eye[1]), float(middle[2]))
    return Camera(width, height, float(focal / distance), 1.0 / distance, centre, principal)


def _farthest(cloud: NDArray[np.floating], direction: tuple[float, float, float]) -> float:
    return float((cloud @ np.array(direction, dtype=cloud.dtype)).max())


def _triple(values: NDArray[np.float64]) -> tuple[float, float, float]:
    return float(values[0]), float(values[1]), float(values[2])
