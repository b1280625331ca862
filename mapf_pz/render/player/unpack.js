// The arrays of an episode. They are stored as base64 text of zlib-compressed bytes, packed by `html.py`; some as the
// first value of each agent and the differences between steps.

const ARRAY_TYPES = {
  rows: Int32Array, cols: Int32Array, goalRows: Int32Array, goalCols: Int32Array,
  actions: Int8Array, waitsFor: Int32Array, rewards: Float32Array, weights: Float32Array, observed: Int8Array,
  features: Int16Array, probabilities: Uint16Array, means: Float32Array, preferred: Int8Array, attended: Int16Array,
};
const STORED_AS_DIFFERENCES = ["rows", "cols", "goalRows", "goalCols"];

async function unpack(text, Type) {
  const letters = atob(text), bytes = new Uint8Array(letters.length);
  for (let i = 0; i < letters.length; i++) bytes[i] = letters.charCodeAt(i);
  const stream = new Blob([bytes]).stream().pipeThrough(new DecompressionStream("deflate"));
  return new Type(await new Response(stream).arrayBuffer());
}

async function unpackAll(texts, length) {
  const arrays = {};
  for (const [name, text] of Object.entries(texts)) arrays[name] = await unpack(text, ARRAY_TYPES[name] ?? Uint8Array);
  for (const name of STORED_AS_DIFFERENCES) if (arrays[name]) addUp(arrays[name], length);
  return arrays;
}
