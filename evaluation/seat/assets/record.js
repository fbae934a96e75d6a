"use strict";
// The log of an episode: what both seats did, and the hash by which a changed log is found.

function base64Of(array) {
  const bytes = new Uint8Array(array.buffer, array.byteOffset, array.byteLength);
  let text = "";
  for (let k = 0; k < bytes.length; k += 8192) {
    text += String.fromCharCode(...bytes.subarray(k, k + 8192));
  }
  return btoa(text);
}

// JSON with sorted keys and without spaces, in ASCII, as `canonical_json` of assistax_base writes it.
function canonical(value) {
  if (Array.isArray(value)) return `[${value.map(canonical).join(",")}]`;
  if (value && typeof value === "object") {
    const keys = Object.keys(value).sort();
    return `{${keys.map((key) => `${canonical(key)}:${canonical(value[key])}`).join(",")}}`;
  }
  return JSON.stringify(value).replace(/[\u007f-\uffff]/g, (letter) => `\\u${letter.charCodeAt(0).toString(16).padStart(4, "0")}`);
}

// Four digits after the point: neither this page nor Python writes such numbers with an exponent.
const plainNumber = (value) => (typeof value === "number" ? Number(value.toFixed(4)) : value);

// SHA-256 of a text in hex. Browsers offer theirs to pages of safe addresses alone.
function sha256(text) {
  const primes = [];
  for (let n = 2; primes.length < 64; ++n) if (primes.every((p) => n % p)) primes.push(n);
  const bitsOf = (x) => ((x - Math.floor(x)) * 2 ** 32) >>> 0;
  const rounds = primes.map((p) => bitsOf(Math.cbrt(p)));
  const hash = primes.slice(0, 8).map((p) => bitsOf(Math.sqrt(p)));
  const given = new TextEncoder().encode(text);
  const bytes = new Uint8Array(((given.length + 72) >> 6) << 6);
  bytes.set(given);
  bytes[given.length] = 0x80;
  const view = new DataView(bytes.buffer);
  view.setUint32(bytes.length - 8, Math.floor(given.length / 2 ** 29));
  view.setUint32(bytes.length - 4, (given.length << 3) >>> 0);
  const turn = (x, n) => (x >>> n) | (x << (32 - n));
  const w = new Uint32Array(64);
  for (let block = 0; block < bytes.length; block += 64) {
    for (let t = 0; t < 64; ++t) {
      if (t < 16) w[t] = view.getUint32(block + 4 * t);
      else {
        const [a, b] = [w[t - 15], w[t - 2]];
        const low = turn(a, 7) ^ turn(a, 18) ^ (a >>> 3);
        w[t] = w[t - 16] + low + w[t - 7] + (turn(b, 17) ^ turn(b, 19) ^ (b >>> 10));
      }
    }
    let [a, b, c, d, e, f, g, h] = hash;
    for (let t = 0; t < 64; ++t) {
      const one = h + (turn(e, 6) ^ turn(e, 11) ^ turn(e, 25)) + ((e & f) ^ (~e & g)) + rounds[t] + w[t];
      const two = (turn(a, 2) ^ turn(a, 13) ^ turn(a, 22)) + ((a & b) ^ (a & c) ^ (b & c));
      [h, g, f, e, d, c, b, a] = [g, f, e, (d + one) >>> 0, c, b, a, (one + two) >>> 0];
    }
    [a, b, c, d, e, f, g, h].forEach((x, i) => (hash[i] = (hash[i] + x) >>> 0));
  }
  return hash.map((x) => x.toString(16).padStart(8, "0")).join("");
}

function deviceOf(kind) {
  const width = Math.round(window.innerWidth);
  const group = width < 600 ? "phone" : width < 1000 ? "tablet" : "desktop";
  return { width, height: Math.round(window.innerHeight), kind, class: group };
}

// Actions and words of an episode, step by step.
class Recording {
  constructor(module, about) {
    Object.assign(this, { module, about, dropped: 0, rows: { robot: [], human: [] }, said: [] });
  }

  add(word) {
    for (const role of ["robot", "human"]) this.rows[role].push(this.module.tree(role).slice());
    this.said.push(word);
  }

  log(kind) {
    const joined = (rows) => {
      const made = new Float32Array(rows.length * rows[0].length);
      rows.forEach((row, k) => made.set(row, k * row.length));
      return base64Of(made);
    };
    const { header } = this.module;
    const figures = Object.entries(this.module.figures()).map(([name, value]) => [name, plainNumber(value)]);
    const { name, sha256: hash } = header.robots[this.about.robot];
    const log = {
      format: header.format,
      task: header.task,
      environment: header.environment,
      engine: header.engine,
      robot: { name, sha256: hash },
      study: this.about.study,
      start: this.about.start,
      wish: Object.fromEntries(Object.entries(this.about.wish).map(([one, value]) => [one, plainNumber(value)])),
      device: deviceOf(kind),
      dropped: this.dropped,
      steps: this.said.length,
      actions: { robot: joined(this.rows.robot), human: joined(this.rows.human) },
      words: base64Of(Int8Array.from(this.said)),
      result: Object.fromEntries(figures),
      saved: new Date().toISOString().slice(0, 10),
      consent: [true, true, true],
    };
    return { ...log, sha256: sha256(canonical(log)) };
  }
}
