// One groom as it is drawn: ribbons that face the viewer, an instance for each segment, smooth between the points.

import {
  BufferAttribute,
  DataTexture,
  GLSL3,
  InstancedBufferGeometry,
  InstancedInterleavedBuffer,
  InterleavedBufferAttribute,
  Mesh,
  NearestFilter,
  DoubleSide,
  RawShaderMaterial,
  Vector3,
} from "three";

import { offsetsOf, places, uint16, uint32, uint8 } from "./decode.js";
import { lightGrid } from "./light.js";
import { HAIR_FRAGMENT, HAIR_VERTEX } from "./shaders.js";

const STRANDS_A_MESH = 65_280; // their numbers fit into 16 bits, their colours into 256 x 255
const FLAT_PX = 0.2; // how far a drawn strand may leave its curve
const MOST_PIECES = 12; // of one segment

// about: what the page says of one groom. centre: of the scene [cm], which becomes its origin.
export async function openHair(about, centre) {
  const counts = await uint32(about.counts);
  const offsets = offsetsOf(counts);
  const points = await places(about.points, offsets);
  const origin = about.origin.map((value, c) => value - centre[c]);
  const hair = { about, offsets, points, origin, step: about.step, ids: await uint32(about.ids) };
  hair.low = about.low.map((value, c) => value - centre[c]);
  hair.high = about.high.map((value, c) => value - centre[c]);
  hair.labels = about.labels && (await openLabels(about.labels));
  return hair;
}

async function openLabels(about) {
  const labels = { type: await uint8(about.type) };
  for (const name of ["radius", "wavelength", "twist"]) {
    const { values, step } = about[name];
    labels[name] = Float32Array.from(await uint16(values), (value) => (value === 0xffff ? NaN : value * step));
  }
  return labels;
}

export function place(hair, i, out) {
  for (let c = 0; c < 3; c++) out[c] = hair.origin[c] + hair.step * hair.points[3 * i + c];
  return out;
}

// Meshes of a hair, the uniforms they share, and what changes how many strands are drawn and in which colours.
export function drawnHair(hair, shared, width, extent, onHead) {
  const grid = lightGrid(hair, width, extent, onHead);
  const bend = bendOf(hair);
  const pieces = { value: 1 };
  const strands = hair.offsets.length - 1;
  const meshes = [];
  for (let first = 0; first < strands; first += STRANDS_A_MESH) {
    const last = Math.min(first + STRANDS_A_MESH, strands);
    meshes.push(ribbons(hair, first, last, pieces, grid, shared));
  }
  return {
    grid,
    meshes: meshes.map(({ mesh }) => mesh),
    segments: hair.offsets[strands] - strands,
    // Strands come shuffled: the first ones are a fair part of all. scale: pixels per cm.
    show(fraction, scale) {
      // A parabola's chord leaves it by an eighth of the second difference; n pieces divide that by n squared.
      const wanted = Math.ceil(Math.sqrt((0.125 * scale * bend) / FLAT_PX));
      pieces.value = Math.max(1, Math.min(MOST_PIECES, wanted));
      for (const { mesh, first, last } of meshes) {
        mesh.geometry.setDrawRange(0, 6 * pieces.value);
        const shown = first + Math.max(1, Math.round(fraction * (last - first)));
        mesh.geometry.instanceCount = hair.offsets[shown] - hair.offsets[first] - 1;
      }
    },
    // colours: (S x 4) bytes, square roots of linear reflectance and 255 where the strand is shown.
    paint(colours) {
      for (const { texture, first, last } of meshes) {
        texture.image.data.set(colours.subarray(4 * first, 4 * last));
        texture.needsUpdate = true;
      }
    },
  };
}

function ribbons(hair, first, last, pieces, grid, shared) {
  const { points, offsets } = hair;
  const [begin, end] = [offsets[first], offsets[last]];
  const row = new Uint16Array(4 * (end - begin + 3)); // one point before the first and two behind the last
  row.fill(0xffff);
  for (let s = first; s < last; s++) {
    for (let i = offsets[s]; i < offsets[s + 1]; i++) {
      const at = 4 * (i - begin + 1);
      row[at] = points[3 * i];
      row[at + 1] = points[3 * i + 1];
      row[at + 2] = points[3 * i + 2];
      row[at + 3] = s - first;
    }
  }
  const geometry = new InstancedBufferGeometry();
  const buffer = new InstancedInterleavedBuffer(row, 4, 1);
  // The same buffer four times, each a point further.
  for (let k = 0; k < 4; k++) geometry.setAttribute(`p${k}`, new InterleavedBufferAttribute(buffer, 4, 4 * k));
  const corners = [];
  const index = [];
  for (let k = 0; k <= MOST_PIECES; k++) {
    corners.push(k, -1, k, 1);
    if (k < MOST_PIECES) index.push(2 * k, 2 * k + 1, 2 * k + 2, 2 * k + 2, 2 * k + 1, 2 * k + 3);
  }
  geometry.setAttribute("corner", new BufferAttribute(new Float32Array(corners), 2));
  geometry.setIndex(index);
  geometry.instanceCount = end - begin - 1;
  const texture = new DataTexture(new Uint8Array(4 * 256 * 256), 256, 256);
  texture.minFilter = texture.magFilter = NearestFilter;
  const uniforms = {
    ...shared,
    grid: { value: grid.texture },
    gridLow: { value: grid.low },
    gridSpan: { value: grid.span },
    origin: { value: new Vector3(...hair.origin) },
    unit: { value: hair.step },
    pieces,
    strands: { value: texture },
  };
  const material = new RawShaderMaterial({
    uniforms,
    vertexShader: HAIR_VERTEX,
    fragmentShader: HAIR_FRAGMENT,
    glslVersion: GLSL3,
    side: DoubleSide,
  });
  const mesh = new Mesh(geometry, material);
  mesh.frustumCulled = false;
  return { mesh, texture, first, last };
}

// How much strands bend from a segment to the next: most second differences of their points are smaller [cm].
function bendOf({ points, offsets, step }) {
  const bends = [];
  const every = Math.max(1, Math.floor((offsets.length - 1) / 200));
  for (let s = 0; s + 1 < offsets.length; s += every) {
    for (let i = offsets[s] + 1; i + 1 < offsets[s + 1]; i++) {
      const second = [0, 1, 2].map((c) => points[3 * i - 3 + c] - 2 * points[3 * i + c] + points[3 * i + 3 + c]);
      bends.push(step * Math.hypot(...second));
    }
  }
  bends.sort((a, b) => a - b);
  return bends.length ? bends[Math.floor(0.9 * bends.length)] : 0;
}
