// What colour each strand has: its hair's, or that of its label.

// Linear reflectances, by how much melanin they hold and of which kind.
export const HAIR = {
  Black: [0.014, 0.011, 0.01],
  "Dark brown": [0.062, 0.033, 0.02],
  Brown: [0.13, 0.07, 0.038],
  Auburn: [0.17, 0.052, 0.024],
  Copper: [0.36, 0.115, 0.035],
  "Dark blond": [0.3, 0.19, 0.1],
  Blond: [0.52, 0.38, 0.21],
  Grey: [0.3, 0.3, 0.305],
  White: [0.68, 0.665, 0.63],
};
export const TYPES = ["I", "II", "III", "IV", "V", "VI", "VII", "VIII"];
const VARIATION = 0.22; // standard deviation of the logarithm of a strand's brightness

// Dark to light and even to the eye, for values; and eight colours in the order of the types. sRGB.
const RAMP = ["#352a6f", "#3a4f9e", "#2f7aa6", "#2a9d8f", "#63b868", "#b3c94a", "#f5d547"];
export const TYPE_COLOURS = ["#4059ad", "#3a8fc4", "#27a69a", "#6bb04e", "#c9b037", "#e8893a", "#d9504f", "#a4408f"];
export const UNREAD = "#8c8c90";
const DIM = 0.62; // reflectance of a label's colour: at its full one highlights would wash it out

export const linear = (value) => (value <= 0.04045 ? value / 12.92 : ((value + 0.055) / 1.055) ** 2.4);
const encoded = (value) => (value <= 0.0031308 ? 12.92 * value : 1.055 * value ** (1 / 2.4) - 0.055);
export const fromHex = (hex) => [1, 3, 5].map((i) => linear(parseInt(hex.slice(i, i + 2), 16) / 255));
export const toHex = (colour) =>
  `#${colour.map((value) => Math.round(255 * encoded(value)).toString(16).padStart(2, "0")).join("")}`;

export const rampCss = `linear-gradient(to right, ${RAMP.join(", ")})`;
const STOPS = RAMP.map(fromHex);

function onRamp(share) {
  const at = Math.max(0, Math.min(1, share)) * (STOPS.length - 1);
  const k = Math.min(Math.floor(at), STOPS.length - 2);
  return STOPS[k].map((value, c) => value + (at - k) * (STOPS[k + 1][c] - value));
}

// The range that a ramp spans: most of the values of all hairs; lengths by their logarithm.
export function rangeOf(hairs, name) {
  if (name === "twist") return [0, 1];
  const values = hairs.flatMap(({ labels }) => Array.from(labels[name]).filter((value) => value > 0));
  if (!values.length) return null;
  values.sort((a, b) => a - b);
  const [low, high] = [0.03, 0.97].map((share) => values[Math.floor(share * (values.length - 1))]);
  return high > 1.05 * low ? [low, high] : [low / 1.05, high * 1.05];
}

// Bytes (S x 4): square roots of reflectance, and 255 where the strand is shown.
export function strandColours(hair, { by, colour, hidden, picked }, range) {
  const strands = hair.offsets.length - 1;
  const bytes = new Uint8Array(4 * strands);
  const types = TYPE_COLOURS.map(fromHex);
  const unread = fromHex(UNREAD);
  for (let s = 0; s < strands; s++) {
    const type = hair.labels ? hair.labels.type[s] : 255;
    let own;
    if (by === "hair") {
      const brightness = Math.exp(VARIATION * Math.sqrt(12) * (noise(hair.ids[s], 0) - 0.5));
      const warmth = 0.16 * (noise(hair.ids[s], 1) - 0.5);
      own = [colour[0] * brightness * (1 + warmth), colour[1] * brightness, colour[2] * brightness * (1 - warmth)];
    } else {
      own = unread;
      if (by === "type") own = types[type] || unread;
      else if (range && hair.labels) {
        const value = hair.labels[by][s];
        const [low, high] = range;
        if (by === "twist" && value >= 0) own = onRamp(value);
        else if (value > 0) own = onRamp(Math.log(value / low) / Math.log(high / low));
      }
      const shade = DIM * (0.88 + 0.24 * noise(hair.ids[s], 0));
      own = own.map((value) => shade * value);
    }
    if (picked === s) own = [0.95, 0.2, 0.55];
    for (let c = 0; c < 3; c++) bytes[4 * s + c] = Math.round(255 * Math.sqrt(Math.max(0, Math.min(1, own[c]))));
    bytes[4 * s + 3] = hidden.has(type < TYPES.length ? type : 255) ? 0 : 255;
  }
  return bytes;
}

// A number in [0, 1) from a strand's index: the finaliser of MurmurHash3.
function noise(index, salt) {
  let x = Math.imul(2 * index + salt + 1, 0x9e3779b1);
  x = Math.imul(x ^ (x >>> 16), 0x85ebca6b);
  x = Math.imul(x ^ (x >>> 13), 0xc2b2ae35);
  return ((x ^ (x >>> 16)) >>> 0) / 2 ** 32;
}
