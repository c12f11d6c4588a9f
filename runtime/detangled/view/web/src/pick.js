// Which strand is under the pointer, and what is said of it.

import { Matrix4, Vector3 } from "three";

import { TYPES } from "./colours.js";
import { place } from "./hair.js";

const REACH_PX = 7;

// x, y: in CSS pixels of the canvas. colours: of the hair, to pass over strands that are not shown.
export function strandAt(hair, colours, camera, canvas, x, y) {
  camera.updateMatrixWorld(); // the view may have changed since it was drawn
  const turn = new Matrix4().multiplyMatrices(camera.projectionMatrix, camera.matrixWorldInverse);
  const [halfWidth, halfHeight] = [canvas.clientWidth / 2, canvas.clientHeight / 2];
  const [point, at] = [new Vector3(), []];
  let [best, nearest] = [-1, Infinity];
  for (let s = 0; s + 1 < hair.offsets.length; s++) {
    if (!colours[4 * s + 3]) continue;
    let [lastX, lastY] = [NaN, NaN];
    for (let i = hair.offsets[s]; i < hair.offsets[s + 1]; i++) {
      point.fromArray(place(hair, i, at)).applyMatrix4(turn);
      const px = (1 + point.x) * halfWidth - x;
      const py = (1 - point.y) * halfHeight - y;
      const away = i > hair.offsets[s] ? fromSegment(lastX, lastY, px, py) : Math.hypot(px, py);
      if (away < REACH_PX && point.z < nearest && Math.abs(point.z) <= 1) [best, nearest] = [s, point.z];
      [lastX, lastY] = [px, py];
    }
  }
  return best;
}

function fromSegment(ax, ay, bx, by) {
  const [dx, dy] = [bx - ax, by - ay];
  const t = Math.max(0, Math.min(1, -(ax * dx + ay * dy) / (dx * dx + dy * dy || 1)));
  return Math.hypot(ax + t * dx, ay + t * dy);
}

export function strandWords(hair, s, walker) {
  let length = 0;
  const [a, b] = [[], []];
  for (let i = hair.offsets[s]; i + 1 < hair.offsets[s + 1]; i++) {
    place(hair, i, a);
    place(hair, i + 1, b);
    length += Math.hypot(b[0] - a[0], b[1] - a[1], b[2] - a[2]);
  }
  const words = [`strand ${hair.ids[s].toLocaleString("en")}`, `${size(length)} cm long`];
  if (!hair.labels) return words.join(" · ");
  const type = TYPES[hair.labels.type[s]];
  if (!type) return [...words, "not read"].join(" · ");
  words.push(`type ${type} (${walker[type]})`);
  const [radius, wavelength, twist] = ["radius", "wavelength", "twist"].map((name) => hair.labels[name][s]);
  if (radius > 0) words.push(`radius ${size(radius)} cm`, `wavelength ${size(wavelength)} cm`, `twist ${twist.toFixed(2)}`);
  else words.push("straight");
  return words.join(" · ");
}

export const size = (value) => (value < 10 ? value.toFixed(2) : value.toFixed(1));
