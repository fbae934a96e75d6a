"use strict";
// Plays an episode: the scene, what the person wishes, and forces and reward over time.
// `playEpisode(place, bytes)` fills an element; places that hold their episode are filled at once.

const SPEEDS = [0.1, 0.25, 0.5, 1, 2, 4];
const FELT = 0.3; // N, from where on a touch counts as one
const MOODS = {
  none: { colour: "transparent", words: { force: "no touch", speed: "no touch" } },
  less: { colour: "#7aa6d8", words: { force: "lighter than liked", speed: "slower than liked" } },
  liked: { colour: "#009e73", words: { force: "as liked", speed: "as liked" } },
  more: { colour: "#e69f00", words: { force: "harder than liked", speed: "faster than liked" } },
  hurt: { colour: "#b3261e", words: { force: "it hurts", speed: "it hurts" } },
};

function levelOf(episode, newtons) {
  return episode.levels.filter((level, i) => !i || newtons >= level.from).at(-1);
}

// How a value is liked while the person is touched: within a factor of two of the wish, or not.
function moodOf(episode, step, name) {
  const wish = episode.wishes.find((one) => one.name === name);
  if (episode.hurts[step]) return "hurt";
  if (!wish || episode.force[step] <= FELT) return "none";
  const share = episode[name][step] / wish.value;
  return share < 0.5 ? "less" : share > 2 ? "more" : "liked";
}

// Share of the time with a touch in which its force was liked; NaN without any touch.
function sharesLiked(episode) {
  const moods = episode.force.map((_, step) => moodOf(episode, step, "force"));
  const touched = moods.filter((mood) => mood !== "none");
  return touched.filter((mood) => mood === "liked").length / touched.length;
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

function playEpisode(place, episode, { autoplay = false } = {}) {
  const last = episode.poses.length - 1;
  const state = { step: 0, playing: false, speed: 1, behind: 0, before: 0, queued: false };
  const cursors = [];
  const updates = []; // what changes with the step

  place.replaceChildren();
  place.classList.add("episode");
  place.tabIndex = 0;
  place.setAttribute("role", "group");
  place.setAttribute("aria-label", `Episode of ${episode.robot} with ${episode.person}`);
  const grid = element("div", "episode-grid");
  const [left, right] = [element("div"), element("div")];
  grid.append(left, right);
  place.append(grid);

  // The scene, with words on it.
  const stage = element("div", "episode-stage");
  left.append(stage);
  let scene = null;
  const canvas = element("canvas");
  canvas.setAttribute("role", "img");
  canvas.setAttribute("aria-label", "The robot, the person and the forces between them");
  if (element("canvas").getContext("webgl2")) {
    stage.append(canvas);
    scene = episodeScene(canvas, episode);
  } else {
    const words = "This browser cannot draw the scene (no WebGL). The curves show the episode without it.";
    stage.append(element("p", "episode-missing", words));
  }
  const labels = Object.fromEntries(
    ["robot", "person", "target", "force"].map((kind) => {
      const label = element("span", "episode-label", kind === "target" ? episode.targets[0]?.label : kind);
      label.dataset.kind = kind;
      label.hidden = true;
      stage.append(label);
      return [kind, label];
    }),
  );

  function placeLabels() {
    const found = scene.labels();
    for (const [kind, label] of Object.entries(labels)) {
      const at = found[kind];
      const [right, bottom] = [stage.clientWidth + 60, stage.clientHeight + 60];
      label.hidden = !at || at[0] < -60 || at[1] < -60 || at[0] > right || at[1] > bottom;
      if (label.hidden) continue;
      if (kind === "force") {
        label.textContent = `${figure(episode.force[state.step])} N`;
        label.style.setProperty("--level", levelOf(episode, episode.force[state.step]).colour);
      }
      // Beside what it names, and inside the picture.
      const [width, height] = [label.offsetWidth, label.offsetHeight];
      const x = Math.max(4, Math.min(stage.clientWidth - width - 4, at[0] - width / 2));
      const y = Math.max(4, Math.min(stage.clientHeight - height - 4, at[1] - height / 2));
      label.style.transform = `translate(${x.toFixed(1)}px, ${y.toFixed(1)}px)`;
    }
  }

  function draw() {
    if (state.queued || !scene) return;
    state.queued = true;
    requestAnimationFrame(() => {
      state.queued = false;
      scene.show(state.step);
      scene.draw();
      placeLabels();
    });
  }

  function seek(step) {
    state.step = Math.max(0, Math.min(last, Math.round(step)));
    for (const update of updates) update(state.step);
    for (const cursor of cursors) cursor.style.left = `${(100 * state.step) / last}%`;
    draw();
  }

  // Controls.
  const button = (words, act, className = "") => {
    const made = element("button", className, words);
    made.type = "button";
    made.addEventListener("click", act);
    return made;
  };
  const controls = element("div", "episode-controls");
  const play = button("Play", () => toggle(), "play");
  const slider = element("input");
  Object.assign(slider, { type: "range", min: 0, max: last, step: 1, value: 0 });
  slider.setAttribute("aria-label", "Moment of the episode");
  slider.addEventListener("input", () => seek(Number(slider.value)));
  const time = element("span", "episode-time");
  const speed = element("select");
  speed.setAttribute("aria-label", "Speed");
  for (const value of SPEEDS) speed.append(new Option(`${value}×`, value, value === 1, value === 1));
  speed.addEventListener("change", () => (state.speed = Number(speed.value)));
  controls.append(play, slider, time, speed);
  left.append(controls);
  const help = "Drag to turn, wheel after a click to zoom, Shift and drag to move. Space plays, ← and → step, Home and End jump, , and . change the speed, C comes close.";
  left.append(element("p", "episode-help", help));
  const close = button("Close up", () => setClose(!scene.view.close));
  if (scene) {
    const corner = element("div", "episode-corner");
    corner.append(close, button("Reset", () => setClose(false)));
    stage.append(corner);
  }
  function setClose(wanted) {
    if (!scene) return;
    scene.reset(wanted);
    close.setAttribute("aria-pressed", String(wanted));
    draw();
  }
  updates.push((step) => {
    slider.value = step;
    const seconds = (count) => (count * episode.seconds).toFixed(2);
    time.textContent = `${seconds(step)} of ${seconds(last)} s`;
    slider.setAttribute("aria-valuetext", `${seconds(step)} seconds`);
  });

  function toggle(wanted = !state.playing) {
    if (wanted && state.step === last) seek(0);
    state.playing = wanted;
    play.textContent = wanted ? "Pause" : "Play";
    state.before = 0;
    if (wanted) requestAnimationFrame(advance);
  }

  function advance(now) {
    if (!state.playing) return;
    const passed = state.before ? Math.min(0.25, (now - state.before) / 1000) : 0;
    state.before = now;
    state.behind += (passed * state.speed) / episode.seconds;
    const steps = Math.floor(state.behind);
    state.behind -= steps;
    if (steps) seek(state.step + steps);
    if (state.step === last) toggle(false);
    else requestAnimationFrame(advance);
  }

  // Who plays, and what the person wishes.
  const who = element("dl", "episode-who");
  for (const [name, value] of episode.facts) who.append(element("dt", "", name), element("dd", "", value));
  left.append(who);
  const now = element("div", "episode-now");
  right.append(now);
  function tile(name, write) {
    const [box, value, words] = [element("div"), element("b"), element("span")];
    box.append(element("span", "", name), value, words);
    now.append(box);
    updates.push((step) => {
      const [text, said, colour] = write(step);
      value.textContent = text;
      words.textContent = said;
      box.style.setProperty("--level", colour ?? "var(--p-line)");
    });
  }
  const wishOf = (name) => episode.wishes.find((wish) => wish.name === name && episode[name]);
  const [likedForce, likedSpeed] = [wishOf("force"), wishOf("speed")];
  tile("force on the person", (step) => {
    const mood = moodOf(episode, step, "force");
    const level = levelOf(episode, episode.force[step]);
    const said = likedForce || mood === "hurt" ? MOODS[mood].words.force : episode.force[step] > FELT ? level.label : "no touch";
    return [`${figure(episode.force[step])} N`, said, likedForce ? MOODS[mood].colour : level.colour];
  });
  if (likedSpeed) {
    tile("speed of the tool", (step) => {
      const mood = moodOf(episode, step, "speed");
      return [`${figure(100 * episode.speed[step])} cm/s`, MOODS[mood].words.speed, MOODS[mood].colour];
    });
  }
  const returns = [];
  episode.reward.reduce((sum, reward, i) => (returns[i] = sum + reward), 0);
  tile("return so far", (step) => [figure(returns[step]), `${figure(returns[last])} in the end`]);

  // Curves.
  function add(plot, name, value) {
    const curve = element("div", "episode-curve");
    const [words, shown] = [element("p"), element("b")];
    words.append(element("span", "", name), shown);
    curve.append(words, follow(plot));
    right.append(curve);
    updates.push((step) => (shown.textContent = value(step)));
    return curve;
  }
  function follow(plot) {
    const cursor = element("i", "episode-cursor");
    plot.append(cursor);
    cursors.push(cursor);
    const to = (event) => {
      const box = plot.getBoundingClientRect();
      seek((last * (event.clientX - box.left)) / box.width);
    };
    plot.addEventListener("pointerdown", (event) => {
      plot.setPointerCapture(event.pointerId);
      to(event);
    });
    plot.addEventListener("pointermove", (event) => event.buttons && to(event));
    return plot;
  }
  const ceiling = (values, wish) => 1.15 * Math.max(...values, wish ? 2 * wish.value : 0, 1e-3);
  function limits(plot, low, high, unit) {
    const [top, bottom] = [element("span", "", `${high} ${unit}`), element("span", "", String(low))];
    top.style.top = "3px";
    bottom.style.bottom = "2px";
    plot.append(top, bottom);
    return plot;
  }
  const liking = (wish) => (wish ? `, likes ${figure(wish.value * wish.scale, 0)} ${wish.unit} (green)` : "");
  const most = ceiling(episode.force, likedForce);
  const forces = curveOf(episode.force, { height: 92, low: 0, high: most, wish: likedForce, label: "Force over time", roots: true });
  const curve = add(limits(forces, 0, figure(most, 0), "N"), `force on the person${liking(likedForce)}`, (step) => `${figure(episode.force[step])} N`);
  curve.dataset.curve = "force";
  if (likedForce) addMoods(curve);
  if (likedSpeed) {
    const fastest = Math.min(ceiling(episode.speed, likedSpeed), 12 * likedSpeed.value);
    const speeds = curveOf(episode.speed, { height: 56, low: 0, high: fastest, wish: likedSpeed, label: "Speed over time", roots: true });
    add(limits(speeds, 0, figure(100 * fastest, 0), "cm/s"), `speed of the tool${liking(likedSpeed)}`, (step) => `${figure(100 * episode.speed[step])} cm/s`);
  }
  const [worst, best] = [Math.min(0, ...episode.reward), Math.max(1e-3, ...episode.reward)];
  const rewards = curveOf(episode.reward, { height: 64, low: worst, high: best, label: "Reward over time" });
  add(limits(rewards, figure(worst), figure(best), ""), "reward of a step", (step) => figure(episode.reward[step], 2));
  addTerms();

  function addMoods(curve) {
    const strip = element("div", "episode-mood");
    const moods = episode.force.map((_, step) => moodOf(episode, step, "force"));
    for (let start = 0, end = 1; start < moods.length; start = end++) {
      while (end < moods.length && moods[end] === moods[start]) end += 1;
      const part = element("i");
      part.style.width = `${(100 * (end - start)) / moods.length}%`;
      part.style.background = MOODS[moods[start]].colour;
      strip.append(part);
    }
    const key = element("p", "episode-key");
    for (const mood of ["less", "liked", "more", "hurt"]) {
      const swatch = element("i");
      swatch.style.background = MOODS[mood].colour;
      const word = element("span");
      word.append(swatch, MOODS[mood].words.force);
      key.append(word);
    }
    const share = sharesLiked(episode);
    const told = isNaN(share) ? "The robot never touches the person." : `Of the time with a touch, ${figure(100 * share, 0)}% was as liked (within a factor of two).`;
    curve.append(strip, key, element("p", "episode-liking", told));
  }

  function addTerms() {
    const box = element("div", "episode-terms");
    const never = [];
    for (const [name, values] of Object.entries(episode.terms)) {
      const [low, high] = [Math.min(0, ...values), Math.max(0, ...values)];
      if (low > -0.005 && high < 0.005) {
        never.push(name.replaceAll("_", " "));
        continue;
      }
      const shown = element("b");
      const plot = follow(curveOf(values, { height: 24, low, high, label: `${name} over time` }));
      box.append(element("span", "", name.replaceAll("_", " ")), plot, shown);
      updates.push((step) => (shown.textContent = figure(values[step], 2)));
    }
    right.append(element("p", "episode-help", "What the reward is the sum of:"), box);
    if (never.length) right.append(element("p", "episode-help", `Always 0: ${never.join(", ")}.`));
  }

  // The pointer on the scene, and keys.
  const pointers = new Map();
  if (scene) {
    const apart = () => {
      const [a, b] = [...pointers.values()];
      return Math.hypot(a.x - b.x, a.y - b.y);
    };
    canvas.addEventListener("pointerdown", (event) => {
      place.focus({ preventScroll: true });
      canvas.setPointerCapture(event.pointerId);
      pointers.set(event.pointerId, { x: event.clientX, y: event.clientY });
    });
    canvas.addEventListener("pointermove", (event) => {
      const before = pointers.get(event.pointerId);
      if (!before) return;
      const distance = pointers.size === 2 ? apart() : 0;
      const [dx, dy] = [event.clientX - before.x, event.clientY - before.y];
      pointers.set(event.pointerId, { x: event.clientX, y: event.clientY });
      if (pointers.size === 2) scene.zoom(distance / Math.max(1, apart()));
      else if (event.shiftKey || event.buttons === 2) scene.pan(dx, dy);
      else scene.orbit(dx, dy);
      draw();
    });
    for (const end of ["pointerup", "pointercancel"]) {
      canvas.addEventListener(end, (event) => pointers.delete(event.pointerId));
    }
    canvas.addEventListener("contextmenu", (event) => event.preventDefault());
    canvas.addEventListener(
      "wheel",
      (event) => {
        if (!place.contains(document.activeElement)) return; // the page scrolls
        event.preventDefault();
        scene.zoom(Math.exp(event.deltaY * 0.001));
        draw();
      },
      { passive: false },
    );
    new ResizeObserver(draw).observe(stage);
  }
  const faster = (by) => {
    speed.selectedIndex = Math.max(0, Math.min(SPEEDS.length - 1, speed.selectedIndex + by));
    state.speed = Number(speed.value);
  };
  const keys = {
    " ": () => toggle(),
    ArrowLeft: (far) => seek(state.step - (far ? 25 : 1)),
    ArrowRight: (far) => seek(state.step + (far ? 25 : 1)),
    Home: () => seek(0),
    End: () => seek(last),
    ",": () => faster(-1),
    ".": () => faster(1),
    c: () => setClose(!scene?.view.close),
  };
  place.addEventListener("keydown", (event) => {
    const inside = event.target === slider || event.target === speed || event.target.tagName === "BUTTON";
    const act = keys[event.key.length === 1 ? event.key.toLowerCase() : event.key];
    if (!act || event.ctrlKey || event.altKey || event.metaKey) return;
    if (inside && event.key !== "," && event.key !== "." && event.key !== "c") return; // their own keys
    event.preventDefault();
    act(event.shiftKey);
  });

  seek(0);
  place.episodePlayer = { episode, seek, toggle, state, bodies: () => (scene?.show(state.step), scene?.bodies()) };
  place.dataset.steps = last;
  if (autoplay && !matchMedia("(prefers-reduced-motion: reduce)").matches) toggle(true);
}

for (const place of document.querySelectorAll("[data-episode]")) {
  const bytes = Uint8Array.from(atob(place.dataset.episode), (letter) => letter.charCodeAt(0));
  delete place.dataset.episode;
  unpacked(bytes).then((episode) => playEpisode(place, episode, { autoplay: place.dataset.autoplay !== undefined }));
}
