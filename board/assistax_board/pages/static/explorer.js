"use strict";
// Fetches the numbers of a cross-play and hands them to the viewer. The mean return comes first, so
// that the matrix is soon there; other measures follow.
(async () => {
  const place = document.getElementById("explorer");
  const { numbers, task } = place.dataset;

  async function load(measure) {
    // One float for each pair, robot by robot.
    const answer = await fetch(`${numbers}/${measure}.f32`);
    const all = new Float32Array(await answer.arrayBuffer());
    const columns = data.columns.length;
    return data.rows.map((_, row) => all.subarray(row * columns, (row + 1) * columns));
  }

  const inTask = (policy) => encodeURIComponent(policy.team.split("/")[1]);
  const described = fetch(`${numbers}/matrix.json`).then((answer) => answer.json());
  const data = await described;
  const [first, ...others] = Object.keys(data.measures);
  data.measures[first].values = await load(first);
  document.getElementById("explorer-controls").hidden = false;
  crossPlayMatrix(data, {
    load,
    address: (robot, human) => `/pairs/${task}/${inTask(robot)}/${inTask(human)}`,
    tell: (text) => (document.getElementById("told").textContent = text),
  });
  performance.mark("matrix-drawn");
  for (const name of others) data.measures[name].values ??= await load(name);
  document.body.dataset.measures = others.length + 1; // for whoever tests this page
})();
