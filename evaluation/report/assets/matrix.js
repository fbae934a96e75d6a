"use strict";
// The cross-play matrix on a canvas: zoom, move, look up a pair. Nothing is computed here but
// places and colours.

// data: axes, measures, orders and palettes. options.address: from (robot, human) to the page of a
// pair, which a click opens. options.load: from a measure's name to a promise of its values, for
// those that are not in the data yet. options.tell: takes the pair under the cursor as a text.
function crossPlayMatrix(data, options = {}) {
  const byId = (id) => document.getElementById(id);
  const canvas = byId("matrix"),
    tip = byId("tip"),
    context = canvas.getContext("2d");
  const STRIP = 10,
    GAP = 3,
    FAMILY = "system-ui, 'DejaVu Sans', sans-serif",
    NAME = `11px ${FAMILY}`,
    STRIPS = data.strips.length * (STRIP + GAP);
  const DARK = "#1d2733",
    LIGHT = "#fff",
    MARK = "#d9480f"; // on cells of any colour
  const state = {
    order: Object.keys(data.orders)[0],
    measure: Object.keys(data.measures)[0],
    zoom: 1,
    x: 0,
    y: 0,
  };
  let plot = null,
    picture = null,
    range = [0, 1],
    found = "",
    pinned = null;
  let paper = LIGHT,
    ink = DARK;

  function readColours() {
    // The page's own, which may be dark.
    const body = getComputedStyle(document.body);
    ink = body.color;
    paper = body.backgroundColor;
  }

  const measure = () => data.measures[state.measure];
  const order = () => data.orders[state.order];
  const value = (row, column) => measure().values[order().rows[row]][order().columns[column]];
  const robot = (row) => data.rows[order().rows[row]];
  const human = (column) => data.columns[order().columns[column]];
  const counts = () => [order().rows.length, order().columns.length];
  const share = (v) => (range[1] > range[0] ? (v - range[0]) / (range[1] - range[0]) : 0.5);
  const level = (v) => Math.max(0, Math.min(255, Math.round(255 * share(v))));
  const colour = (v) => data.colours[level(v)];
  const light = (hex) =>
    [1, 3, 5].reduce(
      (sum, at, i) => sum + [0.299, 0.587, 0.114][i] * parseInt(hex.slice(at, at + 2), 16),
      0,
    ) > 128;

  function paint() {
    // One pixel a cell; the canvas scales it without smoothing.
    const [rows, columns] = counts();
    range = [Infinity, -Infinity];
    for (const row of measure().values)
      for (const v of row) range = [Math.min(range[0], v), Math.max(range[1], v)];
    picture = document.createElement("canvas");
    picture.width = columns;
    picture.height = rows;
    const pixels = new ImageData(columns, rows);
    const channels = data.colours.map((hex) =>
      [1, 3, 5].map((at) => parseInt(hex.slice(at, at + 2), 16)).concat(255),
    );
    for (let r = 0; r < rows; r++) {
      for (let c = 0; c < columns; c++) {
        pixels.data.set(channels[level(value(r, c))], 4 * (r * columns + c));
      }
    }
    picture.getContext("2d").putImageData(pixels, 0, 0);
    byId("low").textContent = format(range[0]);
    byId("high").textContent = format(range[1]);
  }

  function lay() {
    const width = canvas.clientWidth,
      [rows, columns] = counts();
    context.font = NAME;
    const longest = (names) =>
      Math.min(
        190,
        width / 5,
        Math.max(...names.map((one) => context.measureText(one.short).width)) + 8,
      );
    const left = longest(data.rows) + STRIPS + 18,
      top = longest(data.columns) + STRIPS + 18;
    const cell = Math.min(48, (width - left - 4) / columns, Math.max(900 - top, 300) / rows);
    plot = { left, top, width: cell * columns, height: cell * rows, fit: cell };
    const height = Math.ceil(top + plot.height + 4),
      ratio = window.devicePixelRatio || 1;
    canvas.style.height = `${height}px`;
    canvas.width = Math.round(width * ratio);
    canvas.height = Math.round(height * ratio);
    context.setTransform(ratio, 0, 0, ratio, 0, 0);
  }

  function clamp() {
    const [rows, columns] = counts();
    const largest = Math.max(1, 64 / plot.fit);
    state.zoom = Math.max(1, Math.min(largest, state.zoom));
    state.x = Math.max(0, Math.min(columns * (1 - 1 / state.zoom), state.x));
    state.y = Math.max(0, Math.min(rows * (1 - 1 / state.zoom), state.y));
  }

  function draw() {
    clamp();
    readColours();
    const cell = plot.fit * state.zoom,
      [rows, columns] = counts();
    context.fillStyle = paper;
    context.fillRect(0, 0, canvas.clientWidth, canvas.clientHeight);
    context.save();
    context.beginPath();
    context.rect(plot.left, plot.top, plot.width, plot.height);
    context.clip();
    context.imageSmoothingEnabled = false;
    context.drawImage(
      picture,
      plot.left - state.x * cell,
      plot.top - state.y * cell,
      columns * cell,
      rows * cell,
    );
    drawCells(cell);
    drawClusters(cell);
    context.restore();
    drawAxis(cell, true);
    drawAxis(cell, false);
    if (pinned) frame(pinned, cell);
  }

  const visible = (start, size, cell, count) => [
    Math.max(0, Math.floor(start)),
    Math.min(count, Math.ceil(start + size / cell)),
  ];
  const left = (column, cell) => plot.left + (column - state.x) * cell;
  const top = (row, cell) => plot.top + (row - state.y) * cell;

  function drawCells(cell) {
    const [rows, columns] = counts(),
      [r0, r1] = visible(state.y, plot.height, cell, rows);
    const [c0, c1] = visible(state.x, plot.width, cell, columns);
    const figures = cell >= 30;
    if (cell < 6) return;
    context.textAlign = "center";
    context.textBaseline = "middle";
    for (let r = r0; r < r1; r++) {
      for (let c = c0; c < c1; c++) {
        const own = robot(r).team !== null && robot(r).team === human(c).team;
        if (!figures && !own) continue;
        const v = value(r, c),
          x = left(c, cell) + cell / 2,
          y = top(r, cell) + cell / 2;
        context.fillStyle = light(colour(v)) ? DARK : LIGHT;
        if (figures) {
          context.font = `${own ? "bold " : ""}${cell >= 44 ? 12 : 10}px ${FAMILY}`;
          context.fillText(format(v), x, y);
        } else {
          context.beginPath();
          context.arc(x, y, Math.min(3.5, cell / 6), 0, 2 * Math.PI);
          context.fill();
        }
      }
    }
  }

  function drawClusters(cell) {
    context.strokeStyle = LIGHT;
    context.lineWidth = 1.5;
    context.beginPath();
    for (const at of order().rowBreaks ?? []) {
      context.moveTo(plot.left, top(at, cell));
      context.lineTo(plot.left + plot.width, top(at, cell));
    }
    for (const at of order().columnBreaks ?? []) {
      context.moveTo(left(at, cell), plot.top);
      context.lineTo(left(at, cell), plot.top + plot.height);
    }
    context.stroke();
  }

  function drawAxis(cell, isRow) {
    const count = counts()[isRow ? 0 : 1],
      size = isRow ? plot.height : plot.width;
    const [first, last] = visible(isRow ? state.y : state.x, size, cell, count);
    context.save();
    context.beginPath();
    if (isRow) context.rect(0, plot.top, plot.left, plot.height);
    else context.rect(plot.left, 0, plot.width, plot.top);
    context.clip();
    context.font = NAME;
    context.textBaseline = "middle";
    for (let i = first; i < last; i++) {
      const one = isRow ? robot(i) : human(i),
        at = isRow ? top(i, cell) : left(i, cell);
      data.strips.forEach((trait, k) => {
        context.fillStyle = data.palettes[trait][one.traits[trait]] ?? "#c8c8c8";
        const offset = (isRow ? plot.left : plot.top) - (k + 1) * (STRIP + GAP);
        if (isRow) context.fillRect(offset, at, STRIP, cell + 0.5);
        else context.fillRect(at, offset, cell + 0.5, STRIP);
      });
      const hit = found && one.name.toLowerCase().includes(found);
      if (cell < 10 && !hit) continue;
      context.fillStyle = hit ? MARK : ink;
      const end = (isRow ? plot.left : plot.top) - STRIPS - 4;
      context.textAlign = isRow ? "right" : "left";
      if (isRow) context.fillText(one.short, end, at + cell / 2, end - 18);
      else {
        context.save();
        context.translate(at + cell / 2, end);
        context.rotate(-Math.PI / 2);
        context.fillText(one.short, 0, 0, end - 18);
        context.restore();
      }
    }
    context.restore();
    context.fillStyle = ink;
    context.font = NAME;
    context.textAlign = "center";
    context.textBaseline = "middle";
    const title = isRow ? `${count} robots (egos)` : `${count} humans (partners)`;
    context.save();
    if (isRow) {
      context.translate(8, plot.top + plot.height / 2);
      context.rotate(-Math.PI / 2);
    } else context.translate(plot.left + plot.width / 2, 8);
    context.fillText(title, 0, 0);
    context.restore();
  }

  function frame([row, column], cell) {
    // A light line around a dark one is seen on every colour, also where a cell is a few pixels.
    const size = Math.max(cell, 5),
      x = left(column, cell) + (cell - size) / 2,
      y = top(row, cell) + (cell - size) / 2;
    for (const [colour, width, out] of [
      [LIGHT, 2, 2.5],
      [MARK, 2, 1],
    ]) {
      context.strokeStyle = colour;
      context.lineWidth = width;
      context.strokeRect(x - out, y - out, size + 2 * out, size + 2 * out);
    }
  }

  function format(v) {
    return Math.abs(v) >= 100 ? v.toFixed(0) : Math.abs(v) >= 10 ? v.toFixed(1) : v.toFixed(2);
  }

  function at(event) {
    const box = canvas.getBoundingClientRect(),
      cell = plot.fit * state.zoom;
    const x = event.clientX - box.left - plot.left,
      y = event.clientY - box.top - plot.top;
    const inside = x >= 0 && y >= 0 && x < plot.width && y < plot.height;
    return {
      x,
      y,
      pair: inside ? [Math.floor(state.y + y / cell), Math.floor(state.x + x / cell)] : null,
    };
  }

  function described([row, column]) {
    const [r, c] = [order().rows[row], order().columns[column]];
    const own = data.rows[r].team !== null && data.rows[r].team === data.columns[c].team;
    const others = Object.entries(data.measures).filter(
      ([name, one]) => name !== state.measure && one.values,
    );
    return [
      `${own ? "self-play" : "cross-play"}: ${format(measure().values[r][c])} ${measure().unit}`,
      `robot ${data.rows[r].name}`,
      `human ${data.columns[c].name}`,
      ...others.map(([, one]) => `${one.label}: ${format(one.values[r][c])} ${one.unit}`),
    ];
  }

  function tell(pair) {
    tip.hidden = !pair;
    if (!pair) return;
    const [row, column] = pair,
      cell = plot.fit * state.zoom;
    tip.replaceChildren(
      ...described(pair).map((text, i) => {
        const line = document.createElement(i ? "div" : "b");
        line.textContent = text;
        return line;
      }),
    );
    // Right of and below the cell, or on its other side where the canvas ends.
    const place = (cellStart, size, room) => {
      const after = cellStart + cell + 10;
      return `${Math.max(0, after + size > room ? cellStart - size - 10 : after)}px`;
    };
    tip.style.left = place(left(column, cell), tip.offsetWidth, canvas.clientWidth);
    tip.style.top = place(top(row, cell), tip.offsetHeight, canvas.clientHeight);
  }

  const quoted = (text) =>
    /^[\w@%+=:,./-]+$/.test(text) ? text : `'${text.replaceAll("'", "'\\''")}'`;

  function hold(pair) {
    // Keep a pair, or none: a report shows its address, and what films it.
    pinned = pair;
    const panel = byId("pair");
    if (!panel) return;
    panel.hidden = !pair;
    if (!pair) {
      history.replaceState(null, "", location.pathname + location.search);
      return;
    }
    const names = { robot: robot(pair[0]).name, human: human(pair[1]).name };
    history.replaceState(null, "", `#${new URLSearchParams(names)}`);
    byId("pair-address").textContent = location.href;
    byId("pair-command").parentElement.hidden = !data.film;
    if (!data.film) return;
    const seats = `--robot ${quoted(names.robot)} --human ${quoted(names.human)}`;
    const preference = data.film.preferences[names.human];
    const option = preference ? ` --preference ${quoted(preference)}` : "";
    byId("pair-command").textContent = `${data.film.command} ${seats}${option} --out pair.mp4`;
  }

  async function copy(button) {
    const source = byId(button.dataset.copy);
    try {
      await navigator.clipboard.writeText(source.textContent);
      button.textContent = "copied";
    } catch {
      getSelection().selectAllChildren(source); // not allowed here: ready for Ctrl-C
      button.textContent = "selected";
    }
    setTimeout(() => (button.textContent = "copy"), 1500);
  }
  for (const button of document.querySelectorAll("[data-copy]"))
    button.addEventListener("click", () => copy(button));

  function open([row, column]) {
    if (options.address) location.assign(options.address(robot(row), human(column)));
  }

  function moveCursor(down, right) {
    // From pair to pair with the keyboard; the part that is shown follows.
    const [rows, columns] = counts(),
      keep = (at, count) => Math.max(0, Math.min(count - 1, at));
    hold(pinned ? [keep(pinned[0] + down, rows), keep(pinned[1] + right, columns)] : [0, 0]);
    const shown = plot.width / (plot.fit * state.zoom),
      high = plot.height / (plot.fit * state.zoom);
    state.x = Math.max(pinned[1] + 1 - shown, Math.min(pinned[1], state.x));
    state.y = Math.max(pinned[0] + 1 - high, Math.min(pinned[0], state.y));
    draw();
    tell(pinned);
    options.tell?.(described(pinned).slice(0, 3).join(", "));
  }

  function zoom(factor, x = plot.width / 2, y = plot.height / 2) {
    const before = plot.fit * state.zoom;
    state.zoom *= factor;
    state.zoom = Math.max(1, Math.min(Math.max(1, 64 / plot.fit), state.zoom));
    const after = plot.fit * state.zoom;
    state.x += x / before - x / after;
    state.y += y / before - y / after;
    draw();
  }

  function show(robotName, humanName) {
    // Zoom to a pair and say what is known of it.
    const row = order().rows.findIndex(
      (i) => data.rows[i].name === robotName || data.rows[i].short === robotName,
    );
    const column = order().columns.findIndex(
      (i) => data.columns[i].name === humanName || data.columns[i].short === humanName,
    );
    if (row < 0 || column < 0) return;
    state.zoom = Math.max(1, 34 / plot.fit);
    const cell = plot.fit * state.zoom;
    state.x = column + 0.5 - plot.width / cell / 2;
    state.y = row + 0.5 - plot.height / cell / 2;
    hold([row, column]);
    draw();
    tell(pinned);
  }

  function choices(id, entries, name, change) {
    const select = byId(id);
    select.replaceChildren(...entries.map(([key, label]) => new Option(label, key)));
    select.addEventListener("change", async () => {
      const chosen = select.value;
      if (name === "measure") data.measures[chosen].values ??= await options.load(chosen);
      state[name] = chosen;
      hits = []; // their places are those of the order before
      hold(null);
      tell(null);
      change();
    });
  }

  choices(
    "order",
    Object.entries(data.orders).map(([key, one]) => [key, one.label]),
    "order",
    () => {
      paint();
      draw();
    },
  );
  choices(
    "measure",
    Object.entries(data.measures).map(([key, one]) => [key, one.label]),
    "measure",
    () => {
      paint();
      draw();
    },
  );
  // What is found, robots first; Enter goes from one to the next.
  let hits = [],
    hit = 0;

  function seek(next) {
    // Scroll and zoom to a hit, so that its name is read.
    byId("find").title = hits.length ? `${next + 1} of ${hits.length}` : "";
    if (!hits.length) return;
    tell(null);
    hit = next;
    const [isRow, i] = hits[hit];
    state.zoom = Math.max(state.zoom, 12 / plot.fit);
    const cell = plot.fit * state.zoom;
    if (isRow) state.y = i + 0.5 - plot.height / cell / 2;
    else state.x = i + 0.5 - plot.width / cell / 2;
    canvas.scrollIntoView({ block: "nearest" });
  }

  byId("find").addEventListener("input", (event) => {
    found = event.target.value.trim().toLowerCase();
    const named = (isRow, at, count) =>
      [...Array(count).keys()]
        .filter((i) => at(i).name.toLowerCase().includes(found))
        .map((i) => [isRow, i]);
    const [rows, columns] = counts();
    hits = found ? [...named(true, robot, rows), ...named(false, human, columns)] : [];
    seek(0);
    draw();
  });
  byId("find").addEventListener("keydown", (event) => {
    if (event.key !== "Enter" || !hits.length) return;
    event.preventDefault();
    seek((hit + (event.shiftKey ? hits.length - 1 : 1)) % hits.length);
    draw();
  });
  byId("in").addEventListener("click", () => zoom(1.6));
  byId("out").addEventListener("click", () => zoom(1 / 1.6));
  byId("all").addEventListener("click", () => {
    Object.assign(state, { zoom: 1, x: 0, y: 0 });
    hold(null);
    tell(null);
    draw();
  });
  byId("ramp").style.background =
    `linear-gradient(to right, ${data.colours.filter((_, i) => i % 15 === 0).join(",")})`;

  function click(pair, isTouch) {
    // A finger cannot point without pressing: its first touch tells, its second opens.
    const again = pinned && pinned[0] === pair[0] && pinned[1] === pair[1];
    if (options.address && (again || !isTouch)) {
      open(pair);
      return;
    }
    hold(pinned && !isTouch ? null : pair);
    draw();
    tell(pinned ?? pair);
  }

  let drag = null;
  canvas.addEventListener("pointerdown", (event) => {
    drag = { x: event.clientX, y: event.clientY, moved: false };
    canvas.setPointerCapture(event.pointerId);
  });
  canvas.addEventListener("pointermove", (event) => {
    if (drag) {
      const cell = plot.fit * state.zoom,
        dx = event.clientX - drag.x,
        dy = event.clientY - drag.y;
      if (drag.moved || Math.hypot(dx, dy) > 4) {
        Object.assign(drag, { x: event.clientX, y: event.clientY, moved: true });
        state.x -= dx / cell;
        state.y -= dy / cell;
        tell(null);
        draw();
      }
      return;
    }
    tell(pinned ?? at(event).pair);
  });
  canvas.addEventListener("pointerup", (event) => {
    const { pair } = at(event);
    if (drag && !drag.moved && pair) click(pair, event.pointerType === "touch");
    drag = null;
  });
  canvas.addEventListener("pointerleave", () => {
    if (!pinned) tell(null);
  });
  canvas.addEventListener("dblclick", (event) => {
    const { x, y, pair } = at(event);
    if (pair) zoom(2, x, y);
  });
  canvas.addEventListener(
    "wheel",
    (event) => {
      const { x, y, pair } = at(event);
      const isMeant = event.ctrlKey || document.activeElement === canvas;
      if (!pair || !isMeant) return; // the page scrolls
      event.preventDefault();
      zoom(Math.exp(-event.deltaY / 300), x, y);
    },
    { passive: false },
  );
  canvas.addEventListener("keydown", (event) => {
    const keys = {
      "+": () => zoom(1.6),
      "=": () => zoom(1.6),
      "-": () => zoom(1 / 1.6),
      0: () => byId("all").click(),
      ArrowLeft: () => moveCursor(0, -1),
      ArrowRight: () => moveCursor(0, 1),
      ArrowUp: () => moveCursor(-1, 0),
      ArrowDown: () => moveCursor(1, 0),
      Enter: () => pinned && open(pinned),
    };
    if (keys[event.key]) {
      event.preventDefault();
      keys[event.key]();
    }
  });

  function follow() {
    // report.html#robot=NAME&human=NAME opens at a pair.
    const wanted = new URLSearchParams(location.hash.slice(1));
    if (wanted.has("robot") && wanted.has("human")) show(wanted.get("robot"), wanted.get("human"));
  }
  window.addEventListener("hashchange", follow);
  new ResizeObserver(() => {
    lay();
    draw();
  }).observe(canvas.parentElement);
  for (const one of [
    matchMedia("(prefers-color-scheme: dark)"),
    ...document.querySelectorAll(".theme"),
  ])
    one.addEventListener("change", () => draw());
  lay();
  paint();
  draw();
  follow();
  document.body.dataset.matrix = counts().join("x"); // for whoever tests this page
}

// A report holds its numbers itself; a page that fetches them calls the function.
const embedded = document.getElementById("matrix-data");
if (embedded) {
  const data = JSON.parse(embedded.textContent);
  crossPlayMatrix(data);
}
