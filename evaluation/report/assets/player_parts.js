"use strict";
// What the player of episodes is made of: moods of a touch, elements, and curves.

const FELT = 0.3; // N, from where on a touch counts as one
const MOODS = { less: "#7aa6d8", preferred: "#009e73", more: "#e69f00", hurt: "#b3261e" }; // colours
// Quantities that a person may prefer and that every moment shows: their names, and words for a
// moment that does not count, and for values below and above the preference.
const QUANTITIES = {
  force: { name: "force on the person", none: "no touch", less: "lighter than preferred", more: "harder than preferred" },
  speed: { name: "speed of the tool", none: "no touch", less: "slower than preferred", more: "faster than preferred" },
  distance: { name: "hook from the arm", none: "the arm does not rest yet", less: "nearer than preferred", more: "farther than preferred" },
};
const moodWords = (mood, name) => ({ preferred: "as preferred", hurt: "it hurts", ...QUANTITIES[name] })[mood];

function levelOf(episode, newtons) {
  return episode.levels.filter((level, i) => !i || newtons >= level.from).at(-1);
}

const LIKED = 1.5; // factor from the preference up to which a value is as preferred

// Whether a value is as preferred. The hook's distance counts while the
// arm rests, other values while the person is touched.
function moodOf(episode, step, name) {
  const preference = episode.preferences.find((one) => one.name === name);
  if (episode.hurts[step]) return "hurt";
  const counts = name === "distance" ? episode.rests[step] : episode.force[step] > FELT;
  if (!preference || !counts) return "none";
  const share = episode[name][step] / preference.value;
  return share < 1 / LIKED ? "less" : share > LIKED ? "more" : "preferred";
}

// Share of the counting time in which a value was as preferred; NaN if no time counted.
function sharePreferred(moods) {
  const counted = moods.filter((mood) => mood !== "none");
  return counted.filter((mood) => mood === "preferred").length / counted.length;
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

// One curve over the episode's steps, with a band about the preferred value. Roots show small values
// beside large ones, so that a peak does not hide the later values.
function curveOf(values, { height, low, high, preference, label, roots = false }) {
  const plot = element("div", "episode-plot");
  plot.style.height = `${height}px`;
  const last = Math.max(1, values.length - 1);
  const share = (value) => (Math.max(low, Math.min(high, value)) - low) / (high - low || 1);
  const y = (value) => 100 - 100 * (roots ? Math.sqrt(share(value)) : share(value));
  const svg = shape("svg", { viewBox: `0 0 ${last} 100`, preserveAspectRatio: "none", role: "img", "aria-label": label });
  if (preference) {
    const [top, bottom] = [y(LIKED * preference.value), y(preference.value / LIKED)];
    svg.append(shape("rect", { class: "preferred", x: 0, y: top, width: last, height: bottom - top }));
    svg.append(shape("path", { class: "preference", d: `M0 ${y(preference.value)}H${last}` }));
  }
  if (low < 0) svg.append(shape("path", { class: "zero", d: `M0 ${y(0)}H${last}` }));
  svg.append(shape("path", { d: `M${values.map((value, i) => `${i} ${y(value).toFixed(2)}`).join("L")}` }));
  plot.append(svg);
  return plot;
}
