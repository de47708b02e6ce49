// What a scene is drawn of, on a canvas of two dimensions: ground, path of the handle, links and joints, apparent mass, axes.

function drawGround(scene, c) {
  c.strokeStyle = scene.inks.grid;
  c.lineWidth = 1;
  const step = ticks(0, scene.size, 4)[1] || scene.size, low = Math.min(0, scene.middle[2] - scene.size);
  for (let k = -5; k <= 5; k++) {
    const [x, y] = [Math.round(scene.middle[0] / step) * step, Math.round(scene.middle[1] / step) * step];
    for (const ends of [[[x + k * step, y - 5 * step, low], [x + k * step, y + 5 * step, low]], [[x - 5 * step, y + k * step, low], [x + 5 * step, y + k * step, low]]]) {
      scene.trace(c, ends);
      c.stroke();
    }
  }
}

function drawTrail(scene, c) {
  if (!scene.trail) return;
  c.strokeStyle = scene.inks.zero;
  c.lineWidth = 1;
  scene.trace(c, scene.way());
  c.stroke();
}

// Where the links come along the motions: their bars at many instants.
function drawSwept(scene, c) {
  c.strokeStyle = scene.inks["c-blue"];
  c.lineCap = "round";
  scene.widths.forEach((width, k) => {
    const ends = scene.swept.slice(2 * k, 2 * k + 2);
    c.globalAlpha = width ? 0.04 : 0.12;
    c.lineWidth = Math.max(2, width * scene.project(ends[0]).scale);
    scene.trace(c, [ends[0], add(ends[1], [1e-6, 0, 0])]); // of a ball, a line without length would not be drawn
    c.stroke();
  });
  c.globalAlpha = 1;
}

// Where two shapes come nearest: the line between their nearest points.
function drawNearest(scene, c) {
  c.strokeStyle = c.fillStyle = scene.inks.vermillion;
  c.lineWidth = 2.5;
  for (const ends of scene.nearest) {
    scene.trace(c, ends);
    c.stroke();
    for (const { x, y } of ends.map((end) => scene.project(end))) c.fillRect(x - 2.5, y - 2.5, 5, 5);
  }
}

function drawPart(scene, c, part) {
  c.lineCap = c.lineJoin = "round";
  if (part.kind === "bar") {
    const wide = 0.03 * scene.size * scene.project(part.points[0]).scale;
    for (const [ink, share] of [[part.link < 0 ? scene.inks.soft : scene.inks.bar, 1], [part.link < 0 ? scene.inks.body : scene.inks["c-blue"], 0.68]]) {
      c.strokeStyle = ink;
      c.lineWidth = Math.max(wide * share, 1.2);
      scene.trace(c, part.points);
      c.stroke();
    }
  } else if (part.kind === "handle") {
    const { x, y } = scene.project(part.points[0]);
    c.strokeStyle = scene.inks.vermillion;
    c.lineWidth = 3;
    c.beginPath();
    c.arc(x, y, 6, 0, 2 * Math.PI);
    c.stroke();
  } else {
    scene.trace(c, part.points, true);
    c.fillStyle = part.kind === "pin" ? scene.inks.paper : part.active ? scene.inks.orange : scene.inks.passive;
    c.strokeStyle = scene.inks.ink;
    c.lineWidth = 1.2;
    c.fill();
    c.stroke();
  }
}

// Half-axes of the ellipsoid are the principal masses, in one scale for all poses.
function drawEllipsoid(scene, c) {
  if (!scene.device.mass) return;
  const { masses: felt, why } = scene.device.felt();
  if (why) {
    scene.words.textContent = why;
    return;
  }
  scene.unit ||= (0.22 * scene.size) / felt[0].mass;
  const at = scene.device.placed(scene.device.links(), scene.device.handle).p;
  const arms = felt.map(({ mass, vector }) => vector.map((v) => v * Math.min(scene.unit * mass, scene.size)));
  c.lineWidth = 1.3;
  c.strokeStyle = scene.inks.vermillion;
  c.fillStyle = "rgba(213,94,0,0.13)";
  for (const [a, b] of [[0, 1], [0, 2], [1, 2]]) {
    if (!arms[a] || !arms[b]) continue;
    scene.trace(c, Array.from({ length: 49 }, (_, k) => add(add(at, arms[a], Math.cos((k * Math.PI) / 24)), arms[b], Math.sin((k * Math.PI) / 24))));
    c.fill();
    c.stroke();
  }
  const text = felt.map(({ mass, vector }) => `${shown(mass, 3)} kg along (${vector.map((v) => shown(Math.round(100 * v) / 100, 2)).join(", ")})`);
  scene.words.textContent = `Apparent mass at the handle: ${text.join("; ")}.`;
}

function drawTriad(scene, c) {
  const length = 0.25 * scene.size;
  c.font = "12px system-ui, sans-serif";
  [["x", [length, 0, 0]], ["y", [0, length, 0]], ["z", [0, 0, length]]].forEach(([name, end]) => {
    c.strokeStyle = c.fillStyle = scene.inks.ink;
    c.lineWidth = 1;
    scene.trace(c, [[0, 0, 0], end]);
    c.stroke();
    const { x, y } = scene.project(end);
    c.fillText(name, x + 3, y - 3);
  });
}

// A closed line about the z axis of a frame.
function ring({ R, p }, radius, corners) {
  return Array.from({ length: corners }, (_, k) => {
    const angle = (2 * Math.PI * (k + 0.5)) / corners;
    return add(add(p, column(R, 0), radius * Math.cos(angle)), column(R, 1), radius * Math.sin(angle));
  });
}
