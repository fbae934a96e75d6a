"use strict";
// Plays an episode: the scene, what the person prefers, and forces and reward over time.
// `playEpisode(place, bytes)` fills an element; places that hold their episode are filled at once.

const SPEEDS = [0.1, 0.25, 0.5, 1, 2, 4];

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
      if (kind === "person") label.textContent = episode.words?.[state.step] ? `says: ${episode.words[state.step]}` : kind;
      if (kind === "target") label.style.borderColor = episode.targets[0].colour;
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

  // Who plays, and what the person prefers.
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
  const preferences = episode.preferences.filter((preference) => episode[preference.name]); // that are seen
  const shown = (name, step) => {
    const { scale, unit } = episode.preferences.find((preference) => preference.name === name) ?? { scale: 1, unit: "N" };
    return `${figure(episode[name][step] * scale)} ${unit}`;
  };
  for (const name of new Set(["force", ...preferences.map((preference) => preference.name)])) {
    const preferred = preferences.some((preference) => preference.name === name);
    tile(QUANTITIES[name].name, (step) => {
      const mood = moodOf(episode, step, name);
      const level = levelOf(episode, episode.force[step]);
      if (preferred || mood === "hurt") return [shown(name, step), moodWords(mood, name), MOODS[mood]];
      const touched = episode.force[step] > FELT;
      return [shown(name, step), touched ? level.label : "no touch", touched ? level.colour : undefined];
    });
  }
  const returns = [];
  episode.reward.reduce((sum, reward, i) => (returns[i] = sum + reward), 0);
  tile("return so far", (step) => [figure(returns[step]), `${figure(returns[last])} in the end`]);

  // Curves.
  function add(plot, name, value) {
    const curve = element("div", "episode-curve");
    const [words, now] = [element("p"), element("b")];
    words.append(element("span", "", name), now);
    curve.append(words, follow(plot));
    right.append(curve);
    updates.push((step) => (now.textContent = value(step)));
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
  function limits(plot, low, high, unit) {
    const [top, bottom] = [element("span", "", `${high} ${unit}`), element("span", "", String(low))];
    top.style.top = "3px";
    bottom.style.bottom = "2px";
    plot.append(top, bottom);
    return plot;
  }
  for (const name of new Set(["force", ...preferences.map((preference) => preference.name)])) {
    const preference = preferences.find((one) => one.name === name);
    const { scale, unit } = preference ?? { scale: 1, unit: "N" };
    const high = 1.15 * Math.max(...episode[name], preference ? 2 * preference.value : 1e-3);
    const [height, label] = [name === "force" ? 92 : 64, `${QUANTITIES[name].name} over time`];
    const plot = curveOf(episode[name], { height, low: 0, high, preference, label, roots: true });
    const preferred = preference ? `, prefers ${figure(preference.value * scale)} ${unit} (green)` : "";
    const curve = add(limits(plot, 0, figure(high * scale, 0), unit), QUANTITIES[name].name + preferred, (step) => shown(name, step));
    curve.dataset.curve = name;
    if (preference && name !== "speed") addMoods(curve, name);
  }
  const [worst, best] = [Math.min(0, ...episode.reward), Math.max(1e-3, ...episode.reward)];
  const rewards = curveOf(episode.reward, { height: 64, low: worst, high: best, label: "Reward over time" });
  add(limits(rewards, figure(worst), figure(best), ""), "reward of a step", (step) => figure(episode.reward[step], 2));
  addTerms();

  function addMoods(curve, name) {
    const strip = element("div", "episode-mood");
    const moods = episode.force.map((_, step) => moodOf(episode, step, name));
    for (let start = 0, end = 1; start < moods.length; start = end++) {
      while (end < moods.length && moods[end] === moods[start]) end += 1;
      const part = element("i");
      part.style.width = `${(100 * (end - start)) / moods.length}%`;
      part.style.background = MOODS[moods[start]] ?? "transparent";
      strip.append(part);
    }
    const key = element("p", "episode-key");
    for (const [mood, colour] of Object.entries(MOODS)) {
      const swatch = element("i");
      swatch.style.background = colour;
      const word = element("span");
      word.append(swatch, moodWords(mood, name));
      key.append(word);
    }
    const share = sharePreferred(moods);
    const [time, never] = name === "force"
      ? ["Of the time with a touch", "The robot never touches the person."]
      : ["Of the time that the arm rests", "The arm never rests."];
    const told = isNaN(share) ? never : `${time}, ${figure(100 * share, 0)}% was as preferred (within a factor of ${LIKED}).`;
    curve.append(strip, key, element("p", "episode-share", told));
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
