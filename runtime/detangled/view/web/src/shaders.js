// Kajiya and Kay's diffuse term and two highlights (1989), shifted along the strand as Marschner et al. measured
// (2003): the strengths are those of detangled.view.shading. The lights turn with the viewer.

const LIGHT = /* glsl */ `
precision highp float;
precision highp sampler3D;
uniform sampler3D grid;
uniform vec3 gridLow, gridSpan, key, rim;
vec4 light(vec3 place) { // light at a place: gradient by direction, mean
  vec4 seen = texture(grid, (place - gridLow) / gridSpan);
  return vec4((seen.xyz * 255.0 - 127.5) / 127.0, seen.w);
}
float from(vec4 seen, vec3 direction) { return clamp(seen.w + dot(seen.xyz, direction), 0.0, 1.0); }
vec3 encoded(vec3 colour) { // linear light to sRGB
  colour = 1.0 - exp(-1.5 * colour);
  return mix(12.92 * colour, 1.055 * pow(colour, vec3(1.0 / 2.4)) - 0.055, step(0.0031308, colour));
}
// Blue is lost first on the way through hair, so that its depths turn warm instead of black.
const vec3 LOSS = vec3(0.80, 1.0, 1.18);
`;

export const HAIR_VERTEX = /* glsl */ `
${LIGHT}
precision highp int;
// Four points in a row: a segment is the middle two, the others bend it. w: the strand's number.
in vec4 p0, p1, p2, p3;
in vec2 corner; // which end of its pieces; across, -1 or 1
uniform mat4 viewMatrix, projectionMatrix;
uniform vec3 origin, eye;
uniform float unit, width, pieces, pixel; // pixel: its size at a distance of 1
uniform sampler2D strands; // colour of each, and whether it is shown
out vec3 place, tangent, albedo;
out vec4 seen;
out float across, jitter;
vec3 at(vec4 p) { return origin + unit * p.xyz; }
void main() {
  int strand = int(p1.w);
  vec4 look = texelFetch(strands, ivec2(strand & 255, strand >> 8), 0);
  if (p1.w != p2.w || look.a < 0.5) {
    gl_Position = vec4(2.0, 2.0, 2.0, 1.0);
    return;
  }
  // A centripetal Catmull-Rom curve; past its ends a strand goes on straight.
  vec3 a = at(p1), d = at(p2);
  vec3 before = p0.w == p1.w ? at(p0) : 2.0 * a - d;
  vec3 after = p3.w == p2.w ? at(p3) : 2.0 * d - a;
  float k0 = sqrt(max(distance(before, a), 1e-7)), k1 = sqrt(max(distance(a, d), 1e-7));
  float k2 = sqrt(max(distance(d, after), 1e-7));
  vec3 b = d - a;
  vec3 m0 = k1 * ((a - before) / k0 - (d - before) / (k0 + k1)) + b;
  vec3 m1 = b - k1 * ((after - d) / (k1 + k2) - (after - a) / k2);
  float t = corner.x / pieces;
  place = a + t * (m0 + t * (3.0 * b - 2.0 * m0 - m1 + t * (m0 + m1 - 2.0 * b)));
  vec3 along = m0 + t * (2.0 * (3.0 * b - 2.0 * m0 - m1) + 3.0 * t * (m0 + m1 - 2.0 * b));
  tangent = normalize(dot(along, along) > 0.0 ? along : b);
  vec3 away = eye - place;
  float far = length(away);
  vec3 side = cross(tangent, away / far);
  side /= max(length(side), 1e-4);
  place += 0.5 * max(width, 0.7 * pixel * far) * corner.y * side;
  across = corner.y;
  seen = light(place);
  albedo = look.rgb * look.rgb; // stored as square roots: eight bits are coarse for dark hair
  jitter = 2.0 * fract(sin(p1.w * 12.9898) * 43758.5453) - 1.0;
  gl_Position = projectionMatrix * viewMatrix * vec4(place, 1.0);
}
`;

export const HAIR_FRAGMENT = /* glsl */ `
${LIGHT}
in vec3 place, tangent, albedo;
in vec4 seen;
in float across, jitter;
uniform vec3 eye;
uniform float gloss;
out vec4 colour;
float lobe(vec3 t, vec3 n, float shift, vec3 h, float exponent) {
  float along = dot(normalize(t + shift * n), h);
  return pow(max(1.0 - along * along, 1e-9), 0.5 * exponent);
}
void main() {
  vec3 t = normalize(tangent), v = normalize(eye - place);
  vec3 side = normalize(cross(t, v)), outward = cross(side, t);
  float u = clamp(across, -1.0, 1.0);
  vec3 n = sqrt(1.0 - u * u) * outward + u * side;
  float along = dot(t, key);
  float diffuse = sqrt(max(1.0 - along * along, 0.0)) * (0.45 + 0.55 * max(0.0, (dot(n, key) + 0.35) / 1.35));
  vec3 h = normalize(key + v);
  float rounded = 0.35 + 0.65 * max(0.0, dot(n, h));
  float white = rounded * lobe(t, outward, -0.07 + 0.06 * jitter, h, 110.0);
  float coloured = rounded * lobe(t, outward, 0.13 + 0.06 * jitter, h, 22.0);
  float alongRim = dot(t, rim), edge = max(0.0, dot(n, rim));
  float backlit = sqrt(max(1.0 - alongRim * alongRim, 0.0)) * (0.3 + 0.7 * edge);
  vec3 lit = pow(vec3(from(seen, key)), LOSS), behind = pow(vec3(from(seen, rim)), LOSS);
  vec3 open = pow(vec3(max(seen.w, 1e-3)), LOSS);
  vec3 root = sqrt(albedo);
  vec3 sum = albedo * (1.45 * lit * diffuse + 0.5 * (0.78 + 0.22 * n.y) * open + 0.9 * behind * backlit);
  sum += gloss * lit * root * (1.1 * white + 7.5 * albedo * coloured);
  sum += gloss * behind * root * 0.5 * backlit * backlit * edge;
  colour = vec4(encoded(sum), 1.0);
}
`;

export const HEAD_VERTEX = /* glsl */ `
${LIGHT}
in vec3 position, normal;
uniform mat4 viewMatrix, projectionMatrix;
out vec3 place, facing;
void main() {
  place = position;
  facing = normal;
  gl_Position = projectionMatrix * viewMatrix * vec4(position, 1.0);
}
`;

export const HEAD_FRAGMENT = /* glsl */ `
${LIGHT}
in vec3 place, facing;
uniform vec3 eye;
out vec4 colour;
void main() {
  vec3 n = normalize(facing);
  if (dot(n, eye - place) < 0.0) n = -n;
  vec4 seen = light(place);
  vec3 skin = vec3(0.34, 0.315, 0.30);
  vec3 lit = pow(vec3(from(seen, key)), LOSS), open = pow(vec3(max(seen.w, 1e-3)), LOSS);
  float diffuse = max(0.0, (dot(n, key) + 0.2) / 1.2);
  colour = vec4(encoded(skin * (1.15 * lit * diffuse + 0.42 * (0.7 + 0.3 * n.y) * open + 0.2 * max(0.0, dot(n, rim)))), 1.0);
}
`;
