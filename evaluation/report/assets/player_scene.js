"use strict";
// The scene of an episode in three dimensions. Positions are computed here from joint angles, as
// MuJoCo does it; nothing is simulated.

// The same rotation after another, of quaternions [w, x, y, z].
function turnTwice(a, b) {
  return [
    a[0] * b[0] - a[1] * b[1] - a[2] * b[2] - a[3] * b[3],
    a[0] * b[1] + a[1] * b[0] + a[2] * b[3] - a[3] * b[2],
    a[0] * b[2] - a[1] * b[3] + a[2] * b[0] + a[3] * b[1],
    a[0] * b[3] + a[1] * b[2] - a[2] * b[1] + a[3] * b[0],
  ];
}

function turned(quat, vector) {
  const [w, ...u] = quat;
  const cross = (a, b) => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
  const t = cross(u, vector).map((x) => 2 * x);
  const v = cross(u, t);
  return vector.map((x, i) => x + w * t[i] + v[i]);
}

// Where bodies are in a pose: position and quaternion of each, in the world.
function bodyPlaces(bodies, pose) {
  const places = [];
  const add = (a, b) => a.map((x, i) => x + b[i]);
  for (const body of bodies) {
    const parent = body.parent < 0 ? { pos: [0, 0, 0], quat: [1, 0, 0, 0] } : places[body.parent];
    let pos = add(parent.pos, turned(parent.quat, body.pos));
    let quat = turnTwice(parent.quat, body.quat);
    for (const joint of body.joints) {
      const anchor = add(pos, turned(quat, joint.pos));
      const half = (pose[joint.angle] - joint.rest) / 2;
      quat = turnTwice(quat, [Math.cos(half), ...joint.axis.map((x) => x * Math.sin(half))]);
      pos = turned(quat, joint.pos).map((x, i) => anchor[i] - x);
    }
    places.push({ pos, quat });
  }
  return places;
}

// Draws an episode on a canvas. `show(step)` poses it, `labels()` says where words belong. A plain
// scene has smooth edges and shadows left out, for machines that draw without a graphics processor.
function episodeScene(canvas, episode, { plain = false } = {}) {
  const { scene: described } = episode;
  const renderer = new THREE.WebGLRenderer({ canvas, antialias: !plain });
  renderer.shadowMap.enabled = !plain;
  const world = new THREE.Scene();
  world.background = new THREE.Color("#eaeef2");
  const camera = new THREE.PerspectiveCamera(described.camera.fovy, 4 / 3, 0.02, 30);
  camera.up.set(0, 0, 1);

  // Light from above, in front of the person.
  world.add(new THREE.HemisphereLight("#ffffff", "#b9c0c8", 2.2));
  const sun = new THREE.DirectionalLight("#ffffff", 2.0);
  sun.position.set(1.6, -1.4, 3.2);
  sun.castShadow = true;
  sun.shadow.mapSize.set(1024, 1024);
  for (const side of ["left", "bottom"]) sun.shadow.camera[side] = -1.8;
  for (const side of ["right", "top"]) sun.shadow.camera[side] = 1.8;
  sun.shadow.bias = -0.001;
  world.add(sun);
  const floor = new THREE.Mesh(
    new THREE.CircleGeometry(2.6, 64),
    new THREE.MeshStandardMaterial({ color: "#d8dee4", roughness: 1 }),
  );
  floor.receiveShadow = true;
  world.add(floor);

  const groups = described.bodies.map(() => {
    const group = new THREE.Group();
    world.add(group);
    return group;
  });
  const meshes = described.meshes.map((mesh) => {
    const geometry = new THREE.BufferGeometry();
    const points = Float32Array.from(mesh.points, (x) => x * described.grain);
    geometry.setAttribute("position", new THREE.BufferAttribute(points, 3));
    geometry.setIndex(mesh.faces);
    geometry.computeVertexNormals();
    return geometry;
  });

  function geometryOf(geom) {
    const [a, b, c] = geom.size;
    const upright = (geometry) => geometry.rotateX(Math.PI / 2); // along z, as in MuJoCo
    switch (geom.kind) {
      case "sphere":
        return new THREE.SphereGeometry(a, 24, 16);
      case "capsule":
        return upright(new THREE.CapsuleGeometry(a, 2 * b, 8, 20));
      case "cylinder":
        return upright(new THREE.CylinderGeometry(a, a, 2 * b, 24));
      case "ellipsoid":
        return new THREE.SphereGeometry(1, 24, 16).scale(a, b, c);
      case "box":
        return new THREE.BoxGeometry(2 * a, 2 * b, 2 * c);
      default:
        return meshes[geom.mesh];
    }
  }

  const paints = new Map();
  function paint([red, green, blue, opacity]) {
    const key = [red, green, blue, opacity].join();
    if (!paints.has(key)) {
      const look = { roughness: 0.75, opacity, transparent: opacity < 1 };
      const material = new THREE.MeshStandardMaterial(look);
      material.color.setRGB(red, green, blue, "srgb");
      paints.set(key, material);
    }
    return paints.get(key);
  }

  for (const geom of described.geoms) {
    const mesh = new THREE.Mesh(geometryOf(geom), paint(geom.colour));
    mesh.position.set(...geom.pos);
    const [w, x, y, z] = geom.quat;
    mesh.quaternion.set(x, y, z, w);
    mesh.castShadow = mesh.receiveShadow = true;
    (geom.body < 0 ? world : groups[geom.body]).add(mesh);
  }

  // Targets are seen through what is before them; forces too.
  function glowing(colour, opacity = 1) {
    const over = { color: colour, opacity, transparent: true, depthTest: false };
    return new THREE.MeshBasicMaterial(over);
  }
  const targets = episode.targets.map((target) => {
    const alone = target.points[0].length === 3;
    return Array.from({ length: target.points[0].length / 3 }, () => {
      const mark = new THREE.Group();
      const dot = new THREE.Mesh(new THREE.SphereGeometry(alone ? 0.014 : 0.008, 20, 14), glowing(target.colour));
      dot.renderOrder = 3;
      mark.add(dot);
      if (alone) {
        const halo = new THREE.Mesh(new THREE.SphereGeometry(0.045, 24, 16), glowing(target.colour, 0.25));
        halo.renderOrder = 2;
        mark.add(halo);
      }
      world.add(mark);
      return mark;
    });
  });

  const most = Math.max(1, ...episode.touches.map((touches) => touches.length));
  const shaft = new THREE.CylinderGeometry(0.008, 0.008, 1, 12).translate(0, -0.5, 0);
  const head = new THREE.ConeGeometry(0.024, 0.05, 16).translate(0, -0.025, 0);
  const arrows = Array.from({ length: most }, () => {
    const arrow = new THREE.Group();
    const material = glowing("#000");
    arrow.shaft = new THREE.Mesh(shaft, material);
    arrow.add(arrow.shaft, new THREE.Mesh(head, material));
    for (const part of arrow.children) part.renderOrder = 4;
    world.add(arrow);
    return arrow;
  });
  const arrowLength = (newtons) => Math.min(0.1 + 0.012 * newtons, 0.4);
  const UP = new THREE.Vector3(0, 1, 0);

  function placeArrows(touches) {
    arrows.forEach((arrow, i) => {
      const touch = touches[i];
      arrow.visible = Boolean(touch);
      if (!touch) return;
      const [x, y, z, dx, dy, dz, newtons] = touch;
      arrow.position.set(x, y, z); // its tip
      arrow.quaternion.setFromUnitVectors(UP, new THREE.Vector3(dx, dy, dz).normalize());
      arrow.shaft.scale.y = arrowLength(newtons);
      arrow.shaft.material.color.set(levelOf(episode, newtons).colour);
    });
  }

  // The camera circles about a point: angles in rad, distance in m.
  const home = {};
  {
    const towards = new THREE.Vector3(...described.camera.towards);
    const pos = new THREE.Vector3(...described.camera.pos);
    const target = pos.clone().addScaledVector(towards, described.camera.distance);
    target.z += 0.08; // a raised arm stays in the picture
    home.distance = 1.2 * described.camera.distance;
    home.azimuth = Math.atan2(-towards.y, -towards.x);
    home.elevation = Math.asin(-towards.z);
    home.target = target;
  }
  const view = { close: false, sharpness: 1 }; // share of the screen's dots
  function reset(close = false) {
    Object.assign(view, home, { target: home.target.clone(), close });
    if (close) view.distance = 0.85;
  }
  reset();

  let shown = 0;
  function show(step) {
    shown = step;
    bodyPlaces(described.bodies, episode.poses[step]).forEach(({ pos, quat }, i) => {
      groups[i].position.set(...pos);
      groups[i].quaternion.set(quat[1], quat[2], quat[3], quat[0]);
    });
    targets.forEach((marks, i) => {
      const points = episode.targets[i].points[step];
      marks.forEach((mark, k) => {
        mark.visible = points[3 * k] !== null;
        if (mark.visible) mark.position.set(...points.slice(3 * k, 3 * k + 3));
      });
    });
    placeArrows(episode.touches[step]);
  }

  function draw() {
    const { clientWidth: width, clientHeight: height } = canvas.parentElement;
    if (!width || !height) return;
    renderer.setPixelRatio(Math.min(2, devicePixelRatio) * view.sharpness);
    renderer.setSize(width, height, false);
    if (view.close) {
      const seen = targets.flat().filter((mark) => mark.visible);
      if (seen.length) {
        view.target.set(0, 0, 0);
        for (const mark of seen) view.target.addScaledVector(mark.position, 1 / seen.length);
      }
    }
    const flat = Math.cos(view.elevation) * view.distance;
    camera.position.set(
      view.target.x + flat * Math.cos(view.azimuth),
      view.target.y + flat * Math.sin(view.azimuth),
      view.target.z + Math.sin(view.elevation) * view.distance,
    );
    camera.aspect = width / height;
    // As much of the scene in a narrow picture as in a wide one.
    const opening = Math.tan((described.camera.fovy * Math.PI) / 360) * Math.max(1, 1.25 / camera.aspect);
    camera.fov = (Math.atan(opening) * 360) / Math.PI;
    camera.updateProjectionMatrix();
    camera.lookAt(view.target);
    renderer.render(world, camera);
  }

  const at = new THREE.Vector3();
  function onCanvas(x, y, z) {
    at.set(x, y, z).project(camera);
    const { clientWidth: width, clientHeight: height } = canvas.parentElement;
    return [((at.x + 1) / 2) * width, ((1 - at.y) / 2) * height];
  }

  // Where words belong, in pixels: the target's beside it, the force's behind its arrow.
  function labels() {
    const body = (name) => groups[described.bodies.findIndex((one) => one.name === name)].position;
    const robot = body("robot_link3");
    const person = body("human_pelvis");
    const found = {
      robot: onCanvas(robot.x, robot.y, robot.z),
      person: onCanvas(person.x, person.y, person.z + 0.1),
    };
    let away = [0, -1]; // from the touch, on the picture
    const touches = episode.touches[shown];
    if (touches.length) {
      const worst = touches.reduce((a, b) => (b[6] > a[6] ? b : a));
      const back = arrowLength(worst[6]);
      const tip = onCanvas(...worst.slice(0, 3));
      const tail = onCanvas(...[0, 1, 2].map((i) => worst[i] - back * worst[i + 3]));
      const way = [tail[0] - tip[0], tail[1] - tip[1]];
      const length = Math.hypot(...way);
      if (length > 8) away = way.map((x) => x / length);
      found.force = [tail[0] + 38 * away[0], tail[1] + 22 * away[1]];
    }
    const first = targets[0]?.find((mark) => mark.visible);
    if (first) {
      const at = onCanvas(first.position.x, first.position.y, first.position.z);
      found.target = [at[0] - 62 * away[0], at[1] - 44 * away[1]];
    }
    return found;
  }

  function orbit(dx, dy) {
    view.azimuth -= dx * 0.008;
    view.elevation = Math.max(-0.2, Math.min(1.5, view.elevation + dy * 0.008));
  }

  function pan(dx, dy) {
    const share = view.distance * 0.0012;
    view.close = false;
    view.target.x += share * (Math.sin(view.azimuth) * dx - Math.cos(view.azimuth) * Math.sin(view.elevation) * dy);
    view.target.y -= share * (Math.cos(view.azimuth) * dx + Math.sin(view.azimuth) * Math.sin(view.elevation) * dy);
    view.target.z += share * Math.cos(view.elevation) * dy;
  }

  function zoom(factor) {
    view.distance = Math.max(0.3, Math.min(5, view.distance * factor));
  }

  // Where bodies are drawn, for whoever holds them against MuJoCo's.
  const bodies = () =>
    Object.fromEntries(described.bodies.map(({ name }, i) => [name, groups[i].position.toArray()]));

  return { show, draw, labels, orbit, pan, zoom, reset, view, bodies, camera, onCanvas };
}
