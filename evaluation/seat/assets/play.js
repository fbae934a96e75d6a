"use strict";
// The page: begins an episode, plays it at 50 steps a second, and offers its log.

const COUNTDOWN = 3; // s
const MOST_STEPS = 5; // in a frame; steps beyond them are dropped
const TRIES = 50; // of starts
const AWAY = 0.08; // m, from the robot's tool to where it goes
const SLOW = 0.05; // s a frame, above which pictures become coarser
const COARSEST = 0.4; // share of the screen's dots
const byKey = { r: "relax", escape: "stop" };

// Whether the browser draws without a graphics processor; null if it cannot draw at all.
function drawsInSoftware() {
  const context = made("canvas", "").getContext("webgl2");
  if (!context) return null;
  const more = context.getExtension("WEBGL_debug_renderer_info");
  return Boolean(more) && /swiftshader|llvmpipe|software/i.test(context.getParameter(more.UNMASKED_RENDERER_WEBGL));
}

class Page {
  constructor(module) {
    Object.assign(this, { module, header: module.header, playing: false, frames: [] });
    const { header } = this;
    this.stage = byId("stage");
    this.pointer = new Pointer(header.seat, this.stage);
    this.card = new WishCard(header, () => this.begin());
    this.curves = new Curves(header);
    this.study = header.study ? new Study(header.robots) : null;
    this.addWords();
    this.addRobots();
    this.addHelpers();
    byId("goal").textContent = header.goal;
    for (const { label, colour } of header.targets) {
      const dot = made("i", "");
      dot.style.background = colour;
      const row = made("li", "");
      row.append(dot, label);
      byId("legend").append(row);
    }
    document.body.dataset.seat = header.seat;
    this.start = this.anyStart();
    this.card.draw();
    byId("start").addEventListener("click", () => (this.playing ? this.end() : this.count()));
    document.addEventListener("keydown", (event) => this.onKey(event, true));
    document.addEventListener("keyup", (event) => this.onKey(event, false));
    for (const box of document.querySelectorAll("#save input")) {
      box.addEventListener("change", () => this.allowSaving());
    }
    byId("save").addEventListener("submit", (event) => {
      event.preventDefault();
      this.save();
    });
    addEventListener("resize", () => this.draw());
    addEventListener("blur", () => this.pointer.keys.clear());
    requestAnimationFrame((now) => this.frame(now));
  }

  // A start by chance, from which the robot still has a way to go: some begin amid a bite.
  anyStart() {
    const measure = (name) => this.module.one("state", `.measures.${name}`);
    let start = 0;
    for (let k = 0; k < TRIES; ++k) {
      start = Math.floor(Math.random() * this.module.starts);
      this.module.begin(start, {}, 0);
      if (measure("force") === 0 && measure("discomfort") === 0 && measure("distance") > AWAY) break;
    }
    return start;
  }

  addWords() {
    this.header.asked.forEach((word, i) => {
      const button = made("button", "", word);
      button.type = "button";
      button.append(made("kbd", "", String(i + 1)));
      button.addEventListener("click", () => this.say(word));
      byId("words").append(button);
    });
  }

  addRobots() {
    const { robots } = this.header;
    for (const one of ["another", "choose"]) byId(one).hidden = Boolean(this.study);
    const places = this.study ? this.study.byLetter : robots.map((_, i) => i);
    places.forEach((robot, place) => {
      const row = made("label", "robot");
      const radio = made("input", "");
      Object.assign(radio, { type: "radio", name: "robot", value: robot, checked: place === 0 });
      radio.disabled = Boolean(this.study);
      radio.addEventListener("change", () => this.begin());
      const { name } = robots[robot];
      row.append(radio, made("span", "", this.study ? letterOf(place) : robotName(name)));
      if (!this.study) row.title = name;
      byId("robots").append(row);
    });
    this.markRobot();
  }

  // Show which robot of a study comes next.
  markRobot() {
    byId("start").textContent = this.study ? `Start ${this.study.letter}` : "Start";
    if (!this.study) return;
    for (const radio of document.querySelectorAll("#robots input")) {
      radio.checked = Number(radio.value) === this.study.robot;
    }
  }

  addHelpers() {
    const mouth = this.header.seat === "mouth";
    byId("depth-name").textContent = mouth ? "lean" : "nearer to you, or farther";
    byId("depth").addEventListener("input", (event) => (this.pointer.slide = event.target.value / 50));
    for (const end of ["change", "pointerup", "blur"]) {
      byId("depth").addEventListener(end, (event) => (event.target.value = this.pointer.slide = 0));
    }
    byId("jaw").addEventListener("input", (event) => (this.pointer.jaw = event.target.value / 100));
    byId("relax").addEventListener("click", () => this.relax());
    const turn = (angle) => () => {
      this.scene.view.azimuth += angle;
      this.draw();
    };
    byId("view-left").addEventListener("click", turn(-0.25));
    byId("view-right").addEventListener("click", turn(0.25));
    byId("view-near").addEventListener("click", () => {
      this.scene.zoom(0.85);
      this.draw();
    });
    byId("view-far").addEventListener("click", () => {
      this.scene.zoom(1 / 0.85);
      this.draw();
    });
  }

  relax() {
    this.pointer.held = 1 - this.pointer.held;
    byId("relax").setAttribute("aria-pressed", String(!this.pointer.held));
  }

  get robot() {
    if (this.study) return this.study.robot;
    return Number(document.querySelector("#robots input:checked").value);
  }

  // Put the scene to the start of an episode.
  begin() {
    if (!this.card?.wish || this.playing) return;
    this.module.begin(this.start, this.card.wish, this.robot);
    if (!this.scene) this.scene = this.makeScene();
    this.pointer.begin(this.module.leaf("view", "['now']"));
    this.pointer.side = this.side();
    byId("relax").setAttribute("aria-pressed", "false");
    this.curves.clear();
    this.word = 0;
    this.draw();
  }

  makeScene() {
    const { scene, targets } = this.header;
    const { camera } = scene;
    const points = this.module.leaf("view", `['${targets[0].name}']`);
    const towards = [0, 1, 2].map((i) => points[i] - camera.pos[i]);
    camera.distance = Math.max(1, towards.reduce((sum, x, i) => sum + x * camera.towards[i], 0));
    this.shown = {
      scene,
      poses: [[]],
      targets: targets.map(({ name, colour }) => ({ name, colour, points: [this.pointsOf(name)] })),
      touches: [[]],
    };
    const canvas = made("canvas", "");
    canvas.setAttribute("role", "img");
    canvas.setAttribute("aria-label", "The robot, and you");
    const plain = drawsInSoftware();
    if (plain === null) {
      byId("missing").hidden = false;
      byId("start").disabled = true;
      return null;
    }
    this.stage.prepend(canvas);
    const made3d = episodeScene(canvas, this.shown, { plain });
    if (plain) made3d.view.sharpness = 0.6;
    const narrow = this.stage.clientWidth < 500;
    made3d.zoom(this.header.seat === "mouth" ? 0.62 : narrow ? 0.66 : 0.8);
    return made3d;
  }

  pointsOf(name) {
    return Array.from(this.module.leaf("view", `['${name}']`), (x) => (Number.isFinite(x) ? x : null));
  }

  // 1 where a head that turns to its left turns to the right on the picture, else -1.
  side() {
    if (this.header.seat !== "mouth" || !this.scene) return 1;
    const [x, y] = this.module.leaf("view", "['forward']");
    const { right } = this.cameraNow();
    return -y * right[0] + x * right[1] < 0 ? -1 : 1;
  }

  cameraNow() {
    const { camera } = this.scene;
    const e = camera.matrixWorld.elements;
    const [right, up] = [e.slice(0, 3), e.slice(4, 7)];
    const away = e.slice(8, 11).map((x) => -x);
    const from = camera.position.toArray();
    const open = Math.tan((camera.fov * Math.PI) / 360);
    const ray = (x, y) => ({
      from,
      way: away.map((one, i) => one + open * (y * up[i] + x * camera.aspect * right[i])),
    });
    return { right, up, away, ray };
  }

  count() {
    byId("result").hidden = true;
    if (!this.study) this.start = this.anyStart();
    this.begin();
    byId("start").disabled = true;
    for (const one of document.querySelectorAll(".locked")) one.disabled = true;
    this.stage.focus();
    this.until = performance.now() + 1000 * COUNTDOWN;
    byId("stage").scrollIntoView({ block: "nearest" });
  }

  go() {
    this.until = null;
    byId("banner").textContent = "";
    byId("start").disabled = false;
    byId("start").textContent = "Stop";
    document.body.classList.add("playing");
    this.playing = true;
    this.behind = 0;
    const study = this.study?.about() ?? { blind: false, block: null, order: null };
    this.recording = new Recording(this.module, { robot: this.robot, start: this.start, wish: this.card.wish, study });
  }

  say(word) {
    this.word = this.header.words.indexOf(word) + 1;
    byId("said").textContent = `you said: ${word}`;
    clearTimeout(this.fades);
    this.fades = setTimeout(() => (byId("said").textContent = ""), 2000);
    if (this.playing) this.stage.focus();
  }

  onKey(event, down) {
    const inside = event.target.closest?.("input, select, summary, button, a") && event.target !== this.stage;
    if (!this.playing || event.ctrlKey || event.metaKey || event.altKey) return;
    const key = event.key.length === 1 ? event.key.toLowerCase() : event.key;
    if (key === "Tab" || (inside && (key === " " || key === "Enter" || event.target.type === "range"))) return;
    const word = this.header.asked[Number(key) - 1];
    if (word && down && !event.repeat) this.say(word);
    else if (byKey[key.toLowerCase()] === "stop" && down) this.end();
    else if (byKey[key] === "relax" && down && !event.repeat && this.header.seat === "arm") this.relax();
    else if (key in ARROWS || ["PageUp", "PageDown", " ", "m"].includes(key)) this.pointer.press(key, down);
    else return;
    event.preventDefault();
  }

  step() {
    const point = this.pointer.sample(this.header.seconds, this.cameraNow());
    this.module.decide(point);
    this.recording.add(this.word);
    this.module.step(this.word);
    this.word = 0;
    const measure = (name) => this.module.leaf("state", `.measures.${name}`);
    this.curves.add(measure("done"), measure("judged"), measure("liked"));
  }

  frame(now) {
    requestAnimationFrame((next) => this.frame(next));
    const passed = (now - (this.before ?? now)) / 1000;
    this.before = now;
    if (this.until) {
      const left = Math.ceil((this.until - now) / 1000);
      byId("banner").textContent = left > 0 ? String(left) : "";
      if (left <= 0) this.go();
    }
    if (!this.playing) return;
    this.keepPace(passed);
    const begun = performance.now();
    this.behind += passed;
    const { seconds } = this.header;
    for (let k = 0; k < MOST_STEPS && this.behind >= seconds && !this.module.over; ++k) {
      this.step();
      this.behind -= seconds;
    }
    const late = Math.floor(this.behind / seconds);
    if (late > 0 && !this.module.over) {
      this.recording.dropped += late;
      this.behind -= late * seconds;
    }
    this.draw();
    this.frames.push(performance.now() - begun);
    if (this.module.over) this.end();
  }

  // Draw fewer dots where frames take too long.
  keepPace(passed) {
    this.pace = 0.9 * (this.pace ?? 0.016) + 0.1 * passed;
    const { view } = this.scene ?? {};
    if (!view || this.pace < SLOW || view.sharpness <= COARSEST) return;
    view.sharpness = Math.max(COARSEST, 0.8 * view.sharpness);
    this.pace = 0.016;
  }

  draw() {
    if (!this.scene) return;
    this.module.run.view();
    this.shown.poses[0] = this.module.leaf("state", ".physics.qpos");
    for (const target of this.shown.targets) target.points[0] = this.pointsOf(target.name);
    this.scene.show(0);
    this.scene.draw();
    const felt = moodOf(this.module);
    showNow(this.module, felt);
    this.drawMarks(felt.mood);
    this.curves.draw();
    const share = this.module.one("state", ".step") / 1000;
    byId("clock").style.width = `${(100 * share).toFixed(1)}%`;
  }

  // The ring about a touch, and where the hand should be.
  drawMarks(mood) {
    const newtons = this.module.one("state", ".measures.force");
    const put = (mark, point) => {
      const [x, y] = this.scene.onCanvas(...point);
      mark.style.transform = `translate(${x.toFixed(1)}px, ${y.toFixed(1)}px)`;
    };
    const ring = byId("ring");
    ring.hidden = newtons < FELT;
    ring.style.setProperty("--mood", MOODS[mood][0]);
    ring.style.setProperty("--size", `${(26 + 13 * Math.sqrt(Math.min(newtons, 60))).toFixed(0)}px`);
    byId("newtons").textContent = `${newtons.toFixed(1)} N`;
    put(ring, this.module.leaf("view", "['tool']"));
    const aim = byId("aim");
    aim.hidden = this.header.seat === "mouth";
    if (!aim.hidden) {
      put(aim, this.playing ? this.pointer.hand : this.module.leaf("view", "['now']"));
      aim.classList.toggle("resting", !this.pointer.held);
    }
  }

  // Stop: an episode that is over can be saved, others are forgotten.
  end() {
    this.playing = false;
    document.body.classList.remove("playing");
    this.markRobot();
    for (const one of document.querySelectorAll(".locked")) one.disabled = false;
    const whole = this.module.over;
    byId("result").hidden = !whole;
    byId("banner").textContent = whole ? "" : "stopped";
    if (!whole) {
      setTimeout(() => (byId("banner").textContent = ""), 1200);
      this.begin();
      return;
    }
    showResult(this.module, this.recording.dropped);
    this.log = this.recording.log(this.pointer.used);
    for (const box of document.querySelectorAll("#save input")) box.checked = false;
    this.allowSaving();
    if (this.study?.played()) {
      this.start = this.anyStart();
      this.card.draw();
    }
    this.markRobot();
    byId("result").scrollIntoView({ block: "nearest" });
  }

  allowSaving() {
    const boxes = [...document.querySelectorAll("#save input")];
    byId("download").disabled = !boxes.every((box) => box.checked);
  }

  save() {
    const text = JSON.stringify(this.log);
    const link = made("a", "");
    link.href = URL.createObjectURL(new Blob([text], { type: "application/json" }));
    link.download = `${this.header.task}-${this.log.sha256.slice(0, 8)}.json`;
    link.click();
    setTimeout(() => URL.revokeObjectURL(link.href), 10_000);
  }
}

let seat = null;
async function open() {
  const packed = await unpackedPage(byId("data").textContent.trim());
  const library = new Blob([packed.part("library")], { type: "text/javascript" });
  const script = made("script", "");
  script.src = URL.createObjectURL(library);
  await new Promise((resolve, reject) => {
    script.onload = resolve;
    script.onerror = reject;
    document.head.append(script);
  });
  seat = new Page(await TaskModule.load(packed));
  document.body.classList.add("ready");
}

open().catch((error) => {
  byId("missing").hidden = false;
  byId("missing").textContent = `The page could not begin: ${error.message}`;
});
