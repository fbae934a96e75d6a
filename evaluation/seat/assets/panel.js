"use strict";
// What stands beside the picture: the wish, the robots, what is felt, the result.

const LIKED = 1.5; // factor from the liked value up to which a touch is as liked
const MOODS = {
  none: ["#9aa5b1", "no touch"],
  touch: ["#5f6b78", "a touch"], // that no wish is about
  less: ["#5b8fcb", "less than liked"],
  liked: ["#00875f", "as you like it"],
  more: ["#b86e00", "more than liked"],
  hurt: ["#b3261e", "it is uncomfortable"],
};
const FELT = 0.3; // N, from where on a touch counts as one
const SHOWN = 500; // steps of a curve: 10 s

const byId = (id) => document.getElementById(id);

function made(tag, className, text = "") {
  const element = document.createElement(tag);
  if (className) element.className = className;
  element.textContent = text;
  return element;
}

const inUnit = (wish, value) => {
  const shown = wish.factor * value;
  return `${shown.toFixed(shown < 9.95 ? 1 : 0)} ${wish.unit}`;
};

const robotName = (name) =>
  ({ script: "the script", "told-script": "the script that is told your wish" })[name] ?? name.split("/")[1].replace(/-v\d+$/, "");

// The card with the wish, and sliders for one's own.
class WishCard {
  constructor(header, changed) {
    Object.assign(this, { header, changed, sliders: new Map() });
    for (const wish of header.wishes) {
      const row = made("label", "slider");
      const words = made("span", "");
      const slider = made("input", "locked");
      Object.assign(slider, { type: "range", min: 0, max: 100, step: 1 });
      slider.addEventListener("input", () => {
        const share = slider.value / 100;
        this.set({ ...this.wish, [wish.name]: wish.low * (wish.high / wish.low) ** share });
      });
      row.append(words, slider);
      byId("own").append(row);
      this.sliders.set(wish.name, [slider, words]);
    }
    byId("another").addEventListener("click", () => this.draw());
  }

  draw() {
    const { cards } = this.header;
    let next = this.card;
    while (next === this.card) next = Math.floor(Math.random() * cards.length);
    this.card = next;
    this.set(cards[next]);
  }

  set(wish) {
    this.wish = Object.fromEntries(Object.entries(wish).map(([name, value]) => [name, plainNumber(value)]));
    const parts = this.header.wishes.map((one) => {
      const [figure, unit] = inUnit(one, this.wish[one.name]).split(" ");
      return one.words.replace("{}", figure).replace(` ${unit}`, `\u00a0${unit}`);
    });
    const all = parts.join(", and ");
    byId("wish").textContent = `${all[0].toUpperCase()}${all.slice(1)}.`;
    for (const one of this.header.wishes) {
      const [slider, words] = this.sliders.get(one.name);
      slider.value = Math.round((100 * Math.log(this.wish[one.name] / one.low)) / Math.log(one.high / one.low));
      words.textContent = `${one.name}: ${inUnit(one, this.wish[one.name])}`;
      slider.setAttribute("aria-valuetext", inUnit(one, this.wish[one.name]));
    }
    this.changed();
  }
}

// Curves of what is done over what is liked, one a wish, with a band where it is as liked.
class Curves {
  constructor(header) {
    this.curves = header.wishes.map((wish) => {
      const figure = made("figure", "curve");
      const caption = made("figcaption", "");
      const now = made("b", "", "–");
      caption.append(made("span", "", wish.name), now);
      const canvas = made("canvas", "");
      canvas.setAttribute("role", "img");
      figure.append(caption, canvas);
      byId("curves").append(figure);
      return { wish, canvas, now, values: [] };
    });
  }

  clear() {
    for (const curve of this.curves) curve.values = [];
  }

  // Add a step: what is done of each wish, and whether it is judged.
  add(done, judged, liked) {
    this.curves.forEach((curve, i) => {
      curve.values.push(judged[i] ? done[i] / liked[i] : NaN);
      curve.last = judged[i] ? done[i] : curve.last;
    });
  }

  draw() {
    for (const { wish, canvas, now, values } of this.curves) {
      const share = values.at(-1);
      now.textContent = Number.isFinite(share) ? `${share.toFixed(1)} × what you like` : "not judged now";
      canvas.setAttribute("aria-label", `${wish.name} in the last ten seconds: ${now.textContent}`);
      const [width, height] = [canvas.clientWidth, canvas.clientHeight];
      const dots = Math.min(2, window.devicePixelRatio || 1);
      if (canvas.width !== Math.round(width * dots)) {
        [canvas.width, canvas.height] = [Math.round(width * dots), Math.round(height * dots)];
      }
      const pen = canvas.getContext("2d");
      pen.setTransform(dots, 0, 0, dots, 0, 0);
      pen.clearRect(0, 0, width, height);
      // Logarithms: from a quarter of what is liked to four times it.
      const y = (ratio) => height * (0.5 - Math.log(Math.max(0.25, Math.min(4, ratio))) / (2 * Math.log(4)));
      pen.fillStyle = "#cdeadf";
      pen.fillRect(0, y(LIKED), width, y(1 / LIKED) - y(LIKED));
      pen.fillStyle = "#00875f";
      pen.fillRect(0, y(1) - 0.5, width, 1);
      const from = Math.max(0, values.length - SHOWN);
      pen.lineWidth = 2;
      pen.strokeStyle = "#1d3f66";
      pen.beginPath();
      for (let k = from, drawn = false; k < values.length; ++k) {
        if (!Number.isFinite(values[k])) drawn = false;
        else {
          pen[drawn ? "lineTo" : "moveTo"](((k - from) * width) / SHOWN, y(values[k]));
          drawn = true;
        }
      }
      pen.stroke();
    }
  }
}

// How a touch is felt now, and the wish that is farthest from what is liked.
function moodOf(module) {
  const measure = (name) => module.leaf("state", `.measures.${name}`);
  const [done, judged, liked] = ["done", "judged", "liked"].map(measure);
  let [worst, wish] = [null, ""];
  module.header.wishes.forEach(({ name }, i) => {
    const off = judged[i] ? Math.log(Math.max(1e-3, done[i]) / liked[i]) : null;
    if (off !== null && (worst === null || Math.abs(off) > Math.abs(worst))) [worst, wish] = [off, name];
  });
  if (measure("discomfort")[0] > 0) return { mood: "hurt", wish: "" };
  if (worst === null) return { mood: measure("force")[0] > FELT ? "touch" : "none", wish: "" };
  if (Math.abs(worst) <= Math.log(LIKED)) return { mood: "liked", wish: "" };
  return { mood: worst > 0 ? "more" : "less", wish };
}

function showNow(module, { mood, wish }) {
  const newtons = module.one("state", ".measures.force");
  byId("force").textContent = `${newtons.toFixed(1)} N`;
  byId("mood").textContent = wish ? `${wish}: ${MOODS[mood][1]}` : MOODS[mood][1];
  byId("felt").style.setProperty("--mood", MOODS[mood][0]);
  byId("score").textContent = module.one("tally", ".returns").toFixed(0);
}

function showResult(module, dropped) {
  const figures = module.figures();
  const seconds = (figures.steps * module.header.seconds).toFixed(1);
  const ended = figures.violation === "none" ? `${seconds} s` : `${seconds} s: the robot touched you too hard, and stopped`;
  const rows = [
    ["goal reached, with care", figures.success ? "yes" : "no"],
    ["score", figures.return.toFixed(0)],
    ["uncomfortable", `${(100 * figures.discomfort_share).toFixed(0)}% of the touch`],
    ["largest force", `${figures.force_peak.toFixed(1)} N`],
    ["time", ended],
  ];
  if (dropped) rows.push(["steps that came too late", String(dropped)]);
  const list = byId("figures");
  list.replaceChildren();
  for (const [name, value] of rows) list.append(made("dt", "", name), made("dd", "", value));
}
