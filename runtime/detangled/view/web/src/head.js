// The mesh that a groom grows on, in a plain tone, shadowed by the hair.

import { BufferAttribute, BufferGeometry, DoubleSide, GLSL3, Mesh, RawShaderMaterial } from "three";

import { places, uint32 } from "./decode.js";
import { HEAD_FRAGMENT, HEAD_VERTEX } from "./shaders.js";

export async function openHead(about, centre) {
  const vertices = await places(about.vertices, [0, about.count]);
  const position = Float32Array.from(
    vertices,
    (value, i) => about.origin[i % 3] - centre[i % 3] + about.step * value,
  );
  const geometry = new BufferGeometry();
  geometry.setAttribute("position", new BufferAttribute(position, 3));
  geometry.setIndex(new BufferAttribute(await uint32(about.faces), 1));
  geometry.computeVertexNormals();
  return geometry;
}

export function drawnHead(geometry, grid, shared) {
  const uniforms = {
    ...shared,
    grid: { value: grid.texture },
    gridLow: { value: grid.low },
    gridSpan: { value: grid.span },
  };
  const material = new RawShaderMaterial({
    uniforms,
    vertexShader: HEAD_VERTEX,
    fragmentShader: HEAD_FRAGMENT,
    glslVersion: GLSL3,
    side: DoubleSide,
  });
  return new Mesh(geometry, material);
}
