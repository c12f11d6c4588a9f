"""The kernels of ``hanging``: energy, gradient and Hessian of a strand, and Newton's method on them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from detangled.kernels import kernel, parallel_kernel, prange
from detangled_training.frames import carried, conjugate, direction, product, row, tangent_of, unit

MOST_ITERATIONS = 300
CLOSE = 1e-6  # of the length: how far at most an unshifted Newton step may move a point for the rest to be found
LARGEST_TURN = 1.0  # [rad] of a segment in one step
ROUNDING = 1e-14  # of the energy: gains below it cannot be told
GOOD_GAIN = 0.25  # of what the Hessian promises, for the shift to shrink
# Levenberg's shift, in units of the mean of l |N|: the smallest, its growth where a step fails and where one succeeds.
LEAST_SHIFT = 1e-6
SHIFT_GROWTH = 8.0
SHIFT_DECAY = 0.2
MOST_SHIFT = 1e12


@kernel
def _bent(q: NDArray[np.float64], half: NDArray[np.float64], j: int) -> tuple:
    """The frame half-way at joint j, as segment j has it, and the rotation u from there to what segment j + 1 has."""
    h = row(half, j)
    middle = product(row(q, j), h)
    u = product(conjugate(middle), product(row(q, j + 1), conjugate(h)))
    if u[0] < 0.0:
        u = (-u[0], -u[1], -u[2], -u[3])
    return middle, u


@kernel
def energy_of(
    q: NDArray[np.float64], half: NDArray[np.float64], k: NDArray[np.float64], pull: NDArray[np.float64]
) -> float:
    """Energy [erg], of pulling counted from straight along the pull, so that rounding is small where energy is."""
    total = 0.0
    for j in range(q.shape[0]):
        strength = np.sqrt(pull[j, 0] ** 2 + pull[j, 1] ** 2 + pull[j, 2] ** 2)
        if strength > 0.0:
            d = tangent_of(row(q, j))
            x = d[0] - pull[j, 0] / strength
            y = d[1] - pull[j, 1] / strength
            z = d[2] - pull[j, 2] / strength
            total += 0.5 * strength * (x * x + y * y + z * z)
        if j > 0:
            _, u = _bent(q, half, j - 1)
            bent = k[j - 1, 0] * u[1] ** 2 + k[j - 1, 1] * u[2] ** 2 + k[j - 1, 2] * u[3] ** 2
            total += bent / (1.0 + u[0])
    return total


@kernel
def _joint(middle: tuple, u: tuple, k: NDArray[np.float64], g: NDArray[np.float64], h: NDArray[np.float64]) -> None:
    """Fill g (3,) and h (3, 3): derivatives of a joint's energy by a world turn of the next segment.

    For turns a and b of the two segments the energy goes, to second order, with w = b - a, as
    g . w + w h w / 2 - g . (a x b) / 2.
    """
    c = u[0]
    v = np.array([u[1], u[2], u[3]])
    n = 1.0 + c
    kv = k * v
    q = (v * kv).sum()
    # How v goes with the turn: dv = D w / 2, D = c - [v]x.
    D = np.array([[c, v[2], -v[1]], [-v[2], c, v[0]], [v[1], -v[0], c]])
    local = np.zeros((3, 3))
    slope = np.zeros(3)  # D' K v
    for a in range(3):
        for i in range(3):
            slope[a] += D[i, a] * kv[i]
    for a in range(3):
        for b in range(3):
            for i in range(3):
                local[a, b] += 0.5 * D[i, a] * k[i] * D[i, b] / n
            local[a, b] += 0.5 * (slope[a] * v[b] + v[a] * slope[b]) / n**2 + 0.5 * q * v[a] * v[b] / n**3
        local[a, a] += -0.5 * q / n + 0.25 * q * c / n**2
    w, x, y, z = middle
    R = np.array(
        [
            [1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - w * z), 2.0 * (x * z + w * y)],
            [2.0 * (x * y + w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - w * x)],
            [2.0 * (x * z - w * y), 2.0 * (y * z + w * x), 1.0 - 2.0 * (x * x + y * y)],
        ]
    )
    half = np.zeros((3, 3))
    for a in range(3):
        g[a] = 0.0
        for i in range(3):
            g[a] += R[a, i] * (slope[i] / n + 0.5 * q / n**2 * v[i])
            for b in range(3):
                half[a, b] += R[a, i] * local[i, b]
    for a in range(3):
        for b in range(3):
            h[a, b] = 0.0
            for i in range(3):
                h[a, b] += half[a, i] * R[b, i]


@kernel
def assemble(
    q: NDArray[np.float64],
    half: NDArray[np.float64],
    k: NDArray[np.float64],
    pull: NDArray[np.float64],
    g: NDArray[np.float64],
    band: NDArray[np.float64],
) -> None:
    """Gradient g (m - 1, 3) and Hessian by world turns of all segments but the first.

    band: (3 (m - 1), 6), row i holds columns i - 5 to i of the Hessian.
    """
    m = q.shape[0]
    band[:] = 0.0
    slope = np.empty(3)
    curve = np.empty((3, 3))
    for j in range(1, m):
        at = 3 * (j - 1)
        d = tangent_of(row(q, j))
        n = pull[j]
        g[j - 1, 0] = -(d[1] * n[2] - d[2] * n[1])
        g[j - 1, 1] = -(d[2] * n[0] - d[0] * n[2])
        g[j - 1, 2] = -(d[0] * n[1] - d[1] * n[0])
        along = d[0] * n[0] + d[1] * n[1] + d[2] * n[2]
        for a in range(3):
            for b in range(a + 1):
                band[at + a, 5 + b - a] -= 0.5 * (d[a] * n[b] + d[b] * n[a])
            band[at + a, 5] += along
    for j in range(m - 1):
        middle, u = _bent(q, half, j)
        _joint(middle, u, k[j], slope, curve)
        cross = np.array([[0.0, -slope[2], slope[1]], [slope[2], 0.0, -slope[0]], [-slope[1], slope[0], 0.0]])
        at = 3 * j  # of segment j + 1
        for a in range(3):
            g[j, a] += slope[a]
            if j > 0:
                g[j - 1, a] -= slope[a]
            for b in range(a + 1):
                band[at + a, 5 + b - a] += curve[a, b]
                if j > 0:
                    band[at - 3 + a, 5 + b - a] += curve[a, b]
            if j > 0:
                for b in range(3):
                    # Row of segment j + 1, column of segment j: the transpose of -h + [g]x / 2.
                    band[at + a, 2 + b - a] += -curve[b, a] + 0.5 * cross[b, a]


@kernel
def _solve(
    band: NDArray[np.float64],
    shift: float,
    slope: NDArray[np.float64],
    step: NDArray[np.float64],
    work: NDArray[np.float64],
) -> bool:
    """The step that solves (band + shift) step = -slope, by Cholesky's method; False where it is not positive."""
    right = step.reshape(step.size)
    down = slope.reshape(slope.size)
    rows = band.shape[0]
    width = band.shape[1] - 1
    for i in range(rows):
        first = max(0, i - width)
        for j in range(first, i + 1):
            total = band[i, width + j - i]
            if i == j:
                total += shift
            for t in range(max(first, j - width), j):
                total -= work[i, width + t - i] * work[j, width + t - j]
            if i == j:
                # A pivot lost to rounding is as bad as one below zero.
                if not total > 1e-14 * abs(band[i, width]):
                    return False
                work[i, width] = np.sqrt(total)
            else:
                work[i, width + j - i] = total / work[j, width]
        total = -down[i]
        for t in range(first, i):
            total -= work[i, width + t - i] * right[t]
        right[i] = total / work[i, width]
    for i in range(rows - 1, -1, -1):
        total = right[i]
        for t in range(i + 1, min(rows, i + width + 1)):
            total -= work[t, width + i - t] * right[t]
        right[i] = total / work[i, width]
    return True


@kernel
def turned(q: NDArray[np.float64], step: NDArray[np.float64], scale: float, out: NDArray[np.float64]) -> None:
    """Segments after world turns step (m - 1, 3) times ``scale`` [rad]; the first stays."""
    out[0] = q[0]
    for j in range(1, q.shape[0]):
        x = scale * step[j - 1, 0]
        y = scale * step[j - 1, 1]
        z = scale * step[j - 1, 2]
        angle = np.sqrt(x * x + y * y + z * z)
        s = 0.5 if angle < 1e-8 else np.sin(0.5 * angle) / angle
        new = unit(product((np.cos(0.5 * angle), s * x, s * y, s * z), row(q, j)))
        for c in range(4):
            out[j, c] = new[c]


@kernel
def _moved(q: NDArray[np.float64], step: NDArray[np.float64], lengths: NDArray[np.float64]) -> float:
    """How far [cm] at most small turns move a point."""
    most = 0.0
    x = 0.0
    y = 0.0
    z = 0.0
    for j in range(1, q.shape[0]):
        d = tangent_of(row(q, j))
        w = step[j - 1]
        x += lengths[j] * (w[1] * d[2] - w[2] * d[1])
        y += lengths[j] * (w[2] * d[0] - w[0] * d[2])
        z += lengths[j] * (w[0] * d[1] - w[1] * d[0])
        most = max(most, x * x + y * y + z * z)
    return np.sqrt(most)


@kernel
def _hang(
    points: NDArray[np.float64],
    frames: NDArray[np.float64],
    start: NDArray[np.float64],
    stiffness: NDArray[np.float64],  # (3,) G J, E I about the major axis, about the minor
    masses: NDArray[np.float64],
    gravity: NDArray[np.float64],
    stretched: bool,
    q: NDArray[np.float64],  # (m, 4), filled
    lengths: NDArray[np.float64],  # (m,), filled
    moment: NDArray[np.float64],  # (3,), filled
    energies: NDArray[np.float64],  # filled as far as it goes
) -> tuple:
    """Converged, iterations, residual [cm], energy [erg]."""
    m = points.shape[0] - 1
    total = 0.0
    for j in range(m):
        _, lengths[j] = direction(points, j)
        total += lengths[j]
        q[j] = start[j] if j > 0 else frames[j]
    half = np.empty((m - 1, 4))
    k = np.empty((m - 1, 3))
    for j in range(m - 1):
        r = product(conjugate(row(frames, j)), row(frames, j + 1))
        if r[0] < 0.0:
            r = (-r[0], -r[1], -r[2], -r[3])
        r = unit((1.0 + r[0], r[1], r[2], r[3]))
        for c in range(4):
            half[j, c] = r[c]
        for c in range(3):
            k[j, c] = 8.0 * stiffness[c] / (lengths[j] + lengths[j + 1])
    pull = np.empty((m, 3))  # weight below times length [dyn cm]
    below = 0.0
    scale = 0.0
    g = np.sqrt((gravity * gravity).sum())
    for j in range(m - 1, -1, -1):
        below += masses[j + 1]
        for c in range(3):
            pull[j, c] = lengths[j] * below * gravity[c]
        scale += lengths[j] * below * g / m
    if stretched:
        down = tangent_of(row(q, 0))
        frame = row(q, 0)
        if g > 0.0:
            target = (gravity[0] / g, gravity[1] / g, gravity[2] / g)
            frame = carried(frame, down, target)
        for j in range(1, m):
            for c in range(4):
                q[j, c] = frame[c]
    slope = np.empty((m - 1, 3))
    step = np.empty((m - 1, 3))
    band = np.empty((3 * (m - 1), 6))
    work = np.empty((3 * (m - 1), 6))
    trial = np.empty((m, 4))
    energy = energy_of(q, half, k, pull)
    if energies.shape[0] > 0:
        energies[0] = energy
    scale = max(scale, 1e-9 * k.mean())
    shift = 0.0
    residual = np.nan
    converged = False
    done = 0
    while done < MOST_ITERATIONS and not converged:
        done += 1
        assemble(q, half, k, pull, slope, band)
        stuck = False
        while not stuck:
            if _solve(band, shift, slope, step, work):
                if shift == 0.0:
                    residual = _moved(q, step, lengths)
                    converged = residual <= CLOSE * total
                largest = np.sqrt((step * step).sum(axis=1).max())
                size = min(1.0, LARGEST_TURN / largest) if largest > 0.0 else 1.0
                gain = -size * (1.0 - 0.5 * size) * (step * slope).sum()  # if all were as the Hessian says
                turned(q, step, size, trial)
                new = energy_of(trial, half, k, pull)
                if new < energy:
                    q[:] = trial
                    if energy - new > GOOD_GAIN * gain:
                        shift = shift * SHIFT_DECAY if shift > LEAST_SHIFT * scale else 0.0
                    energy = new
                    break
                stuck = converged or gain <= ROUNDING * (1.0 + np.sqrt(m)) * energy
            if not stuck:
                shift = max(LEAST_SHIFT * scale, SHIFT_GROWTH * shift)
                stuck = not shift <= MOST_SHIFT * scale  # so too where something is not a number
        if energies.shape[0] > 0:
            energies[done] = energy
        if stuck and not converged:
            # No step that can be told from rounding: what is left is whether this is a minimum.
            if _solve(band, 0.0, slope, step, work):
                residual = _moved(q, step, lengths)
                converged = residual <= CLOSE * total
            break
    if m > 1:
        middle, u = _bent(q, half, 0)
        curve = np.empty((3, 3))
        _joint(middle, u, k[0], moment, curve)
    return converged, done, residual, energy


@parallel_kernel
def hang_all(
    points: NDArray[np.float64],
    offsets: NDArray[np.int64],
    frames: NDArray[np.float64],
    start: NDArray[np.float64],
    stiffness: NDArray[np.float64],
    masses: NDArray[np.float64],
    gravity: NDArray[np.float64],
    stretched: bool,
    out: NDArray[np.float64],
    out_frames: NDArray[np.float64],
    converged: NDArray[np.bool_],
    iterations: NDArray[np.int64],
    residual: NDArray[np.float64],
    moment: NDArray[np.float64],
    energy: NDArray[np.float64],
    energies: NDArray[np.float64],
) -> None:
    for s in prange(offsets.shape[0] - 1):
        a = offsets[s]
        b = offsets[s + 1]
        m = b - a - 1
        usable = np.isfinite(points[a:b]).all() and np.isfinite(frames[a:b]).all() and np.isfinite(start[a:b]).all()
        if usable and m > 1:
            q = np.empty((m, 4))
            lengths = np.empty(m)
            good, done, left, value = _hang(
                points[a:b],
                frames[a:b],
                start[a:b],
                stiffness[s],
                masses[a:b],
                gravity,
                stretched,
                q,
                lengths,
                moment[s],
                energies[s],
            )
            converged[s] = good
            iterations[s] = done
            residual[s] = left
            energy[s] = value
            out[a] = points[a]
            for j in range(m):
                d = tangent_of(row(q, j))
                for c in range(3):
                    out[a + j + 1, c] = out[a + j, c] + lengths[j] * d[c]
                out_frames[a + j] = q[j]
            out_frames[b - 1] = q[m - 1]
        elif usable:
            out[a:b] = points[a:b]
            out_frames[a:b] = frames[a:b]
            converged[s] = True
            residual[s] = 0.0
            moment[s] = 0.0
            energy[s] = 0.0
