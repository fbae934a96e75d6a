"use strict";
// What the player of episodes is made of: how a touch is liked, elements, and curves.

const FELT = 0.3; // N, from where on a touch counts as one
const MOODS = { less: "#7aa6d8", liked: "#009e73", more: "#e69f00", hurt: "#b3261e" }; // colours
// What a person may wish that is seen at every moment: its name, and words where it is no wish yet,
// below it, as it is, and above it.
const WISHED = {
  force: { name: "force on the person", none: "no touch", less: "lighter than liked", more: "harder than liked" },
  speed: { name: "speed of the tool", none: "no touch", less: "slower than liked", more: "faster than liked" },
  distance: { name: "hook from the arm", none: "the arm does not rest yet", less: "nearer than liked", more: "farther than liked" },
};
const moodWords = (mood, name) => ({ liked: "as liked", hurt: "it hurts", ...WISHED[name] })[mood];

function levelOf(episode, newtons) {
  return episode.levels.filter((level, i) => !i || newtons >= level.from).at(-1);
}

// How a value is liked, within a factor of two of the wish or not: of the hook's distance while the
// arm rests, of others while the person is touched.
function moodOf(episode, step, name) {
  const wish = episode.wishes.find((one) => one.name === name);
  if (episode.hurts[step]) return "hurt";
  const counts = name === "distance" ? episode.rests[step] : episode.force[step] > FELT;
  if (!wish || !counts) return "none";
  const share = episode[name][step] / wish.value;
  return share < 0.5 ? "less" : share > 2 ? "more" : "liked";
}

// Share of the time that counts for a wish in which it was as liked; NaN if none counted.
function shareLiked(moods) {
  const counted = moods.filter((mood) => mood !== "none");
  return counted.filter((mood) => mood === "liked").length / counted.length;
}

async function unpacked(bytes) {
  const stream = new Blob([bytes]).stream().pipeThrough(new DecompressionStream("deflate"));
  return JSON.parse(await new Response(stream).text());
}

function element(tag, className = "", text = "") {
  const made = document.createElement(tag);
  if (className) made.className = className;
  made.textContent = text;
  return made;
}

function shape(tag, attributes) {
  const made = document.createElementNS("http://www.w3.org/2000/svg", tag);
  for (const [name, value] of Object.entries(attributes)) made.setAttribute(name, value);
  return made;
}

const figure = (value, digits = 1) => (Math.abs(value) < 0.5 * 10 ** -digits ? 0 : value).toFixed(digits);

// One curve over the episode's steps, with a band of what is liked. Roots show small values beside
// large ones: a peak does not hide what comes after it.
function curveOf(values, { height, low, high, wish, label, roots = false }) {
  const plot = element("div", "episode-plot");
  plot.style.height = `${height}px`;
  const last = Math.max(1, values.length - 1);
  const share = (value) => (Math.max(low, Math.min(high, value)) - low) / (high - low || 1);
  const y = (value) => 100 - 100 * (roots ? Math.sqrt(share(value)) : share(value));
  const svg = shape("svg", { viewBox: `0 0 ${last} 100`, preserveAspectRatio: "none", role: "img", "aria-label": label });
  if (wish) {
    const [top, bottom] = [y(2 * wish.value), y(wish.value / 2)];
    svg.append(shape("rect", { class: "liked", x: 0, y: top, width: last, height: bottom - top }));
    svg.append(shape("path", { class: "wish", d: `M0 ${y(wish.value)}H${last}` }));
  }
  if (low < 0) svg.append(shape("path", { class: "zero", d: `M0 ${y(0)}H${last}` }));
  svg.append(shape("path", { d: `M${values.map((value, i) => `${i} ${y(value).toFixed(2)}`).join("L")}` }));
  plot.append(svg);
  return plot;
}
