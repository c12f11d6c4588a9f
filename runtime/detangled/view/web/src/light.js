// How much light reaches a place inside the hair, from every side: rays marched through a grid of hair density, as
// detangled.view.lighting does for pictures. There the lights stand still. Here they turn with the viewer, so a cell
// keeps the mean of its rays and the direction in which it is most open.

import { Data3DTexture, LinearFilter, RGBAFormat, UnsignedByteType, Vector3 } from "three";

const CELLS = 72 ** 3;
const MOST_CELLS_ALONG = 200;
const PADDING = 2; // empty cells around the hair
const BLOCKING = 0.8; // of a strand's drawn width: hair passes on most of the light that meets it
const MARCH_START = 0.01; // of the extent; nearer, a strand would shadow itself
const MARCH_GROWTH = 1.22; // far hair matters less exactly
const RAYS = 14;
const MOST_SEGMENTS = 400_000; // deposited; strands come shuffled, so the first of them stand for all

function directions() {
  return Array.from({ length: RAYS }, (_, i) => {
    const height = 1 - (2 * (i + 0.5)) / RAYS;
    const turn = i * Math.PI * (3 - Math.sqrt(5));
    const ring = Math.sqrt(1 - height * height);
    return [ring * Math.cos(turn), height, ring * Math.sin(turn)];
  });
}

// hair: see hair.js. width: of the strands as drawn at first. extent: size of the scene. All in cm.
// everywhere: also where there is no hair, for a head that hair shadows.
export function lightGrid(hair, width, extent, everywhere) {
  const span = hair.high.map((high, c) => Math.max(high - hair.low[c], 0.02 * extent));
  const cell = Math.max(Math.cbrt((span[0] * span[1] * span[2]) / CELLS), Math.max(...span) / MOST_CELLS_ALONG);
  const shape = span.map((side) => Math.ceil(side / cell) + 1 + 2 * PADDING);
  const low = hair.low.map((value) => value - PADDING * cell); // the centre of the first cell
  const density = deposited(hair, low, cell, shape);
  const scale = (BLOCKING * width) / (cell * cell);
  for (let i = 0; i < density.length; i++) density[i] *= scale;
  const texture = new Data3DTexture(marched(density, shape, (MARCH_START * extent) / cell, everywhere), ...shape);
  texture.format = RGBAFormat;
  texture.type = UnsignedByteType;
  texture.minFilter = texture.magFilter = LinearFilter;
  texture.needsUpdate = true;
  // Cell centres lie half a texel in from the texture's edge.
  const corner = new Vector3(...low).subScalar(0.5 * cell);
  return { texture, low: corner, span: new Vector3(...shape).multiplyScalar(cell) };
}

function deposited({ points, offsets, origin, step }, low, cell, [nx, ny, nz]) {
  const density = new Float32Array(nx * ny * nz);
  const strands = offsets.length - 1;
  let last = strands;
  while (last > 1 && offsets[last] > MOST_SEGMENTS) last = Math.floor(last * 0.9);
  const stands = strands / last; // each strand for so many
  const at = [0, 1, 2].map((c) => (origin[c] - low[c]) / cell);
  const unit = step / cell;
  for (let s = 0; s < last; s++) {
    for (let i = offsets[s]; i + 1 < offsets[s + 1]; i++) {
      const x = at[0] + unit * points[3 * i];
      const y = at[1] + unit * points[3 * i + 1];
      const z = at[2] + unit * points[3 * i + 2];
      const dx = at[0] + unit * points[3 * i + 3] - x;
      const dy = at[1] + unit * points[3 * i + 4] - y;
      const dz = at[2] + unit * points[3 * i + 5] - z;
      const length = Math.hypot(dx, dy, dz);
      const pieces = Math.floor(length) + 1;
      const share = (stands * length * cell) / pieces;
      for (let k = 0; k < pieces; k++) {
        const t = (k + 0.5) / pieces;
        const [px, py, pz] = [x + t * dx, y + t * dy, z + t * dz];
        const [ix, iy, iz] = [Math.floor(px), Math.floor(py), Math.floor(pz)];
        const [fx, fy, fz] = [px - ix, py - iy, pz - iz];
        let cellAt = ix + nx * (iy + ny * iz);
        for (const wz of [1 - fz, fz]) {
          const w0 = share * wz * (1 - fy);
          const w1 = share * wz * fy;
          density[cellAt] += w0 * (1 - fx);
          density[cellAt + 1] += w0 * fx;
          density[cellAt + nx] += w1 * (1 - fx);
          density[cellAt + nx + 1] += w1 * fx;
          cellAt += nx * ny;
        }
      }
    }
  }
  return density;
}

// RGBA bytes for each cell: the gradient of its light by direction, from -1 to 1, and its mean.
function marched(density, [nx, ny, nz], start, everywhere) {
  const out = new Uint8Array(4 * density.length);
  for (let i = 0; i < out.length; i += 4) out.set([128, 128, 128, 255], i);
  const rays = directions();
  for (let z = 1; z < nz - 1; z++) {
    for (let y = 1; y < ny - 1; y++) {
      for (let x = 1; x < nx - 1; x++) {
        const here = x + nx * (y + ny * z);
        if (!everywhere && !isNearHair(density, here, nx, nx * ny)) continue;
        let mean = 0;
        const gradient = [0, 0, 0];
        for (const [dx, dy, dz] of rays) {
          let depth = 0;
          let size = 1;
          let t = start + 0.5;
          for (;;) {
            // The nearest cell, rather than eight of them: the rays are averaged anyway.
            const px = Math.round(x + t * dx);
            const py = Math.round(y + t * dy);
            const pz = Math.round(z + t * dz);
            if (px < 0 || py < 0 || pz < 0 || px >= nx || py >= ny || pz >= nz) break;
            depth += size * density[px + nx * (py + ny * pz)];
            if (depth > 6) break;
            t += 0.5 * size * (1 + MARCH_GROWTH);
            size *= MARCH_GROWTH;
          }
          const light = Math.exp(-depth);
          mean += light / RAYS;
          gradient[0] += (3 * light * dx) / RAYS;
          gradient[1] += (3 * light * dy) / RAYS;
          gradient[2] += (3 * light * dz) / RAYS;
        }
        for (let c = 0; c < 3; c++) out[4 * here + c] = Math.round(127.5 + 127 * Math.max(-1, Math.min(1, gradient[c])));
        out[4 * here + 3] = Math.round(255 * mean);
      }
    }
  }
  return out;
}

function isNearHair(density, here, row, slice) {
  for (const dz of [-slice, 0, slice]) {
    for (const dy of [-row, 0, row]) {
      const at = here + dz + dy;
      if (density[at - 1] + density[at] + density[at + 1] > 0) return true;
    }
  }
  return false;
}
