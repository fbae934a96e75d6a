// Runs a module's function on words of memory, and prints the words that it leaves.
import fs from "node:fs";

const [wasm, name, ...words] = process.argv.slice(2);
const { instance } = await WebAssembly.instantiate(fs.readFileSync(wasm), {});
const base = instance.exports.memory_at() / 4;
const memory = new Uint32Array(instance.exports.memory.buffer).subarray(base);
memory.set(words.map(Number));
instance.exports[name]();
console.log(JSON.stringify(Array.from(memory.subarray(0, 4096))));
