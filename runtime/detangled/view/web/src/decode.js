// From the page's elements to arrays: what detangled.view.page_points packed.

async function inflated(id) {
  const element = document.getElementById(id);
  const text = element.textContent;
  element.remove(); // tens of megabytes that nobody reads again
  const bytes = Uint8Array.fromBase64 ? Uint8Array.fromBase64(text) : fromBase64(text);
  const stream = new Blob([bytes]).stream().pipeThrough(new DecompressionStream("deflate"));
  return new Uint8Array(await new Response(stream).arrayBuffer());
}

function fromBase64(text) {
  const binary = atob(text);
  const bytes = new Uint8Array(binary.length);
  for (let i = 0; i < bytes.length; i++) bytes[i] = binary.charCodeAt(i);
  return bytes;
}

export const uint32 = async (id) => new Uint32Array((await inflated(id)).buffer);
export const uint16 = async (id) => new Uint16Array((await inflated(id)).buffer);
export const uint8 = inflated;

export function offsetsOf(counts) {
  const offsets = new Uint32Array(counts.length + 1);
  for (let s = 0; s < counts.length; s++) offsets[s + 1] = offsets[s] + counts[s];
  return offsets;
}

// Grid places (P x 3) of points that were stored as differences from the point before, axis by axis, the high
// bytes of all points and then the low ones. The first point of each strand stands as it is.
export async function places(ids, offsets) {
  const planes = await Promise.all(ids.map(inflated));
  const total = offsets[offsets.length - 1];
  const out = new Uint16Array(3 * total);
  for (let axis = 0; axis < 3; axis++) {
    const [high, low] = [planes[2 * axis], planes[2 * axis + 1]];
    for (let s = 0; s + 1 < offsets.length; s++) {
      let value = 0;
      for (let i = offsets[s]; i < offsets[s + 1]; i++) {
        value = (value + (high[i] << 8) + low[i]) & 0xffff;
        out[3 * i + axis] = value;
      }
    }
  }
  return out;
}
