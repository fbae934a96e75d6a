"use strict";
// The module of a task: its memory by name, and an episode of it, step by step.

async function unpackedPage(base64) {
  const bytes = Uint8Array.from(atob(base64), (letter) => letter.charCodeAt(0));
  const stream = new Blob([bytes]).stream().pipeThrough(new DecompressionStream("deflate"));
  const all = await new Response(stream).arrayBuffer();
  const size = new DataView(all).getUint32(0, true);
  const header = JSON.parse(new TextDecoder().decode(new Uint8Array(all, 4, size)));
  const part = (name) => {
    const [offset, length] = header.parts[name];
    return new Uint8Array(all, 4 + size + offset, length);
  };
  header.scene.meshes = unpackedMeshes(header.scene.meshes, part);
  return { header, part };
}

// Meshes from the numbers of their points and indices, whose differences are in two parts.
function unpackedMeshes(sizes, part) {
  const reader = (bytes) => {
    const half = bytes.length / 2;
    let at = 0;
    return (count) => {
      let sum = 0;
      return Array.from({ length: count }, () => {
        sum += ((bytes[at] | (bytes[half + at] << 8)) << 16) >> 16;
        ++at;
        return sum;
      });
    };
  };
  const [points, faces] = [reader(part("points")), reader(part("faces"))];
  return sizes.map(([count, indices]) => {
    const [x, y, z] = [points(count), points(count), points(count)];
    return { points: x.flatMap((one, i) => [one, y[i], z[i]]), faces: faces(indices) };
  });
}

class TaskModule {
  static async load({ header, part }) {
    const { instance } = await WebAssembly.instantiate(part("wasm"), {});
    return new TaskModule(header, part, instance.exports);
  }

  constructor(header, part, run) {
    Object.assign(this, { header, part, run });
    const base = run.memory_at() / 4;
    this.bits = new Uint32Array(run.memory.buffer).subarray(base);
    this.floats = new Float32Array(run.memory.buffer).subarray(base);
    this.ints = new Int32Array(run.memory.buffer).subarray(base);
    this.spans = Object.fromEntries(
      Object.entries(header.memory).map(([tree, leaves]) => {
        const places = Object.values(leaves);
        return [tree, [places[0]?.[0] ?? 0, places.reduce((sum, [, size]) => sum + size, 0)]];
      }),
    );
  }

  // The numbers of a leaf, such as leaf("state", ".reward"): a view, which changes with the module.
  leaf(tree, name) {
    const [at, size, kind] = this.header.memory[tree][name];
    return (kind === "f" ? this.floats : this.ints).subarray(at, at + size);
  }

  // The first number of a leaf.
  one(tree, name) {
    return this.leaf(tree, name)[0];
  }

  tree(name) {
    const [at, size] = this.spans[name];
    return this.floats.subarray(at, at + size);
  }

  words(name) {
    const bytes = this.part(name);
    return new Uint32Array(bytes.buffer.slice(bytes.byteOffset, bytes.byteOffset + bytes.length));
  }

  get starts() {
    return this.words("starts").length / this.startSize;
  }

  // Words of a state before its observations.
  get startSize() {
    const places = Object.entries(this.header.memory.state);
    return places.find(([name]) => name.startsWith(".obs"))[1][0] - this.spans.state[0];
  }

  // Begin an episode from a start, with a person's wish and a robot.
  begin(start, wish, robot) {
    const size = this.startSize;
    const row = this.words("starts").subarray(start * size, (start + 1) * size);
    this.bits.set(row, this.spans.state[0]);
    for (const [name, value] of Object.entries({ ...this.header.usual, ...wish })) {
      this.leaf("state", `.task.preference.${name}`)[0] = value;
    }
    this.robot = robot;
    this.tree("carry").fill(0);
    this.leaf("first", "")[0] = 1;
    const params = this.header.parts[`robot${robot}`];
    if (params) this.bits.set(this.words(`robot${robot}`), this.spans.params[0]);
    this.run.begin();
    this.run.view();
  }

  // Put what robot and person do at a step into `robot` and `human`.
  decide(pointer) {
    this.tree("pointer").set(pointer);
    this.run.visitor();
    const { name } = this.header.robots[this.robot];
    const scripts = { script: this.run.script, "told-script": this.run.told };
    (scripts[name] ?? this.run.network)();
    this.leaf("first", "")[0] = 0;
  }

  // One step of 20 ms under what is in `robot` and `human`, and a word.
  step(word) {
    this.leaf("word", "")[0] = word;
    this.run.step();
  }

  get over() {
    return Boolean(this.one("state", ".terminated") || this.one("state", ".truncated"));
  }

  // Figures of the episode so far, as an episode table has them.
  figures() {
    const tally = (name) => this.one("tally", name);
    const steps = tally(".steps");
    const found = {
      return: tally(".returns"),
      success: Boolean(tally(".success")),
      steps,
      violation: this.header.violations[tally(".caring.violation")],
      discomfort_share: tally(".caring.uneasy") / Math.max(1, tally(".caring.felt")),
      force_mean: tally(".force_sum") / Math.max(1, steps),
      force_peak: tally(".force_peak"),
    };
    this.header.wishes.forEach(({ name }, i) => {
      const wish = (part) => tally(`.caring.wishes[${i}].${part}`);
      const judged = wish("judged");
      found[`liked_${name}`] = wish("liked");
      found[`done_${name}`] = judged ? Math.exp(wish("log_done") / judged) : null;
      found[`within_${name}`] = judged ? wish("within") / judged : null;
    });
    return found;
  }
}
