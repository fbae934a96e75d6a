// Plays a module along a trajectory of Python's and prints how far its trees are from it.
// `node agree.mjs FILE.wasm LAYOUT.json TRAJECTORY.json`
import fs from "node:fs";

const [wasm, layoutFile, trajectoryFile] = process.argv.slice(2);
const { memory } = JSON.parse(fs.readFileSync(layoutFile));
const given = JSON.parse(fs.readFileSync(trajectoryFile));
const { instance } = await WebAssembly.instantiate(fs.readFileSync(wasm), {});
const run = instance.exports;
const base = run.memory_at() / 4;
const bits = new Uint32Array(run.memory.buffer);
const floats = new Float32Array(run.memory.buffer);
const wordsOf = (text) => {
  const bytes = Buffer.from(text, "base64");
  return new Uint32Array(bytes.buffer.slice(bytes.byteOffset, bytes.byteOffset + bytes.length));
};
const leaves = (tree) => Object.entries(memory[tree]);
const spanOf = (tree) => [
  Math.min(...leaves(tree).map(([, [at]]) => at)),
  leaves(tree).reduce((sum, [, [, size]]) => sum + size, 0),
];
const put = (tree, words) => bits.set(words, base + spanOf(tree)[0]);
const rows = Object.fromEntries(Object.entries(given.rows).map(([name, text]) => [name, wordsOf(text)]));
const row = (name, tree, step) => {
  const size = spanOf(tree)[1];
  return rows[name].subarray(step * size, (step + 1) * size);
};

const found = {}; // by leaf: largest difference, and the number of rows with other bits
function compare(name, tree, step) {
  const [start] = spanOf(tree);
  const want = row(name, tree, step);
  const wantFloats = new Float32Array(want.buffer, want.byteOffset, want.length);
  for (const [leaf, [at, size, kind]] of leaves(tree)) {
    const one = (found[`${name}${leaf}`] ??= { off: 0, rows: 0, at: -1 });
    let differs = false;
    for (let k = 0; k < size; ++k) {
      const [mine, other] = [base + at + k, at - start + k];
      if (bits[mine] === want[other]) continue;
      const [a, b] = kind === "f" ? [floats[mine], wantFloats[other]] : [bits[mine] | 0, want[other] | 0];
      if (Number.isNaN(a) && Number.isNaN(b)) continue;
      differs = true;
      const off = Math.abs(a - b) / Math.max(1, Math.abs(b));
      if (!(off <= one.off)) [one.off, one.at] = [off, step];
    }
    one.rows += differs;
  }
}

put("state", rows.start);
put("params", wordsOf(given.params));
run.begin();
compare("start", "state", 0);
const pointer = wordsOf(given.pointer);
const width = spanOf("pointer")[1];
for (let step = 0; step < given.words.length; ++step) {
  put("pointer", pointer.subarray(step * width, (step + 1) * width));
  // At the edge of reach a body's intention may go either way: it starts from Python's.
  if (step) put("body", row("body", "body", step - 1));
  run.visitor();
  compare("body", "body", step);
  compare("human", "human", step);
  put("human", row("human", "human", step));
  for (const robot of ["script", "told"]) {
    if (!run[robot]) continue;
    run[robot]();
    compare(robot, "robot", step);
  }
  put("first", [step === 0 ? 1 : 0]);
  // The network sees Python's observations; its memory is its own.
  const own = bits.slice(base + spanOf("state")[0], base + spanOf("state")[0] + spanOf("state")[1]);
  put("state", step ? row("state", "state", step - 1) : rows.start);
  run.network();
  put("state", own);
  compare("carry", "carry", step);
  compare("robot", "robot", step);
  put("robot", row("robot", "robot", step));
  put("word", [given.words[step]]);
  run.step();
  compare("state", "state", step);
  compare("tally", "tally", step);
  run.view();
  compare("view", "view", step);
}
const clock = performance.now();
for (let k = 0; k < 500; ++k) {
  run.visitor();
  run.network();
  run.step();
  run.view();
}
console.log(JSON.stringify({ found, us: (1e3 * (performance.now() - clock)) / 500 }));
