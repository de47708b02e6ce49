// Kinematics and inertia of the mechanism: link poses, loop closure, apparent (effective) mass at the handle.

const dot = (a, b) => a.reduce((sum, v, k) => sum + v * b[k], 0);
const add = (a, b, f = 1) => a.map((v, k) => v + f * b[k]);
const cross = (a, b) => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
const turn = (R, v) => [0, 3, 6].map((i) => R[i] * v[0] + R[i + 1] * v[1] + R[i + 2] * v[2]);
const times = (A, B) => A.map((_, k) => A[k - (k % 3)] * B[k % 3] + A[k - (k % 3) + 1] * B[(k % 3) + 3] + A[k - (k % 3) + 2] * B[(k % 3) + 6]);
const points = (flat) => Array.from({ length: flat.length / 3 }, (_, k) => [...flat.slice(3 * k, 3 * k + 3)]);
const column = (R, k) => [R[k], R[3 + k], R[6 + k]];

// Solves A x = b for several right-hand sides by Gaussian elimination with pivoting; A and b are lists of rows.
function solved(A, B) {
  const n = A.length, W = A.map((row, k) => [...row, ...B[k]]);
  for (let i = 0; i < n; i++) {
    const best = W.reduce((b, row, r) => (r > i && Math.abs(row[i]) > Math.abs(W[b][i]) ? r : b), i);
    [W[i], W[best]] = [W[best], W[i]];
    if (W[i][i] === 0) return null;
    for (let r = 0; r < n; r++)
      if (r !== i && W[r][i] !== 0) W[r] = add(W[r], W[i], -W[r][i] / W[i][i]);
  }
  return W.map((row, k) => row.slice(n).map((v) => v / row[k]));
}

// Eigenvalues and unit vectors of a symmetric 3 x 3 matrix, by Jacobi rotations.
function eigen(M) {
  const A = M.map((row) => [...row]), V = [[1, 0, 0], [0, 1, 0], [0, 0, 1]];
  for (let sweep = 0; sweep < 30; sweep++)
    for (const [p, q] of [[0, 1], [0, 2], [1, 2]]) {
      if (Math.abs(A[p][q]) < 1e-300) continue;
      const half = (A[q][q] - A[p][p]) / (2 * A[p][q]);
      const t = (half >= 0 ? 1 : -1) / (Math.abs(half) + Math.hypot(half, 1)), c = 1 / Math.hypot(t, 1), s = t * c;
      for (const row of A) [row[p], row[q]] = [c * row[p] - s * row[q], s * row[p] + c * row[q]];
      [A[p], A[q]] = [add(A[p].map((v) => c * v), A[q], -s), add(A[q].map((v) => c * v), A[p], s)];
      for (const row of V) [row[p], row[q]] = [c * row[p] - s * row[q], s * row[p] + c * row[q]];
    }
  return [0, 1, 2].map((k) => ({ value: A[k][k], vector: V.map((row) => row[k]) }));
}

class Mechanism {
  constructor(drawing) {
    this.joints = drawing.joints;
    this.cuts = drawing.cuts;
    this.closure = drawing.closure;
    this.active = drawing.active;
    this.handle = drawing.handle;
    this.mass = drawing.mass;
    this.qa = drawing.sliders.map((s) => s.start);
    this.q = this.closure.way === "direct" ? this.direct(this.qa) : this.walked([...this.closure.start], this.closure.at, this.qa);
  }

  // Joints that follow the active ones directly: at constant rates, or by polynomials.
  direct(qa) {
    const n = qa.length, made = this.joints.map((_, j) => this.closure.offset[j] + dot(this.closure.G.slice(n * j, n * (j + 1)), qa));
    for (const [j, terms] of this.closure.polynomials ?? [])
      made[j] = terms.reduce((sum, [factor, product]) => sum + product.reduce((x, a) => x * qa[a], factor), 0);
    return made;
  }

  // Moves the active joints; false, without motion, where the loops cannot be closed.
  move(qa) {
    const q = this.closure.way === "direct" ? this.direct(qa) : this.walked(this.q, this.qa, qa);
    if (q === null) return false;
    [this.qa, this.q] = [qa, q];
    return true;
  }

  // Continuation from one closed pose to another; the cut joints are closed by Newton's method at each step.
  walked(q, from, to) {
    const steps = Math.max(1, Math.ceil(Math.max(...to.map((v, k) => Math.abs(v - from[k]))) / 0.05));
    for (let s = 1; s <= steps && q; s++) q = this.closed(q, from.map((v, k) => v + ((to[k] - v) * s) / steps));
    return q;
  }

  closed(q, qa) {
    const { unknown, size } = this.closure, known = this.direct(qa);
    const made = known.map((v, j) => (unknown.includes(j) ? q[j] : v));
    for (let k = 0; k < 12; k++) {
      const r = this.gaps(made), J = this.slopes(made, unknown, r);
      const N = unknown.map((_, a) => unknown.map((_, b) => dot(J[a], J[b]) + (a === b ? 1e-12 * dot(J[a], J[a]) : 0)));
      const step = solved(N, unknown.map((_, a) => [-dot(J[a], r)]));
      if (!step) return null;
      unknown.forEach((j, a) => { made[j] += step[a][0]; });
      if (Math.max(...step.map(([v]) => Math.abs(v))) < 1e-10) break;
    }
    return Math.max(...this.gaps(made).map(Math.abs)) < 1e-6 * size ? made : null;
  }

  slopes(q, joints, r) {
    return joints.map((j) => this.gaps(q.map((v, k) => v + (k === j ? 1e-7 : 0))).map((v, k) => (v - r[k]) / 1e-7));
  }

  // Closure residual of each cut joint, as in the library.
  gaps(q) {
    const links = this.links(q), size = this.closure.size;
    return this.cuts.flatMap(({ kind, frame_a, frame_b }) => {
      const [a, b] = [frame_a, frame_b].map((f) => this.placed(links, f));
      const apart = add(a.p, b.p, -1);
      const axes = ({ prismatic: [0, 2], revolute: [2], spherical: [] })[kind].flatMap((k) => add(column(a.R, k), column(b.R, k), -1).map((v) => size * v));
      return [...(kind === "prismatic" ? [0, 1].map((k) => dot(column(b.R, k), apart)) : apart), ...axes];
    });
  }

  placed(links, { link, R, p }) {
    if (link < 0) return { R, p };
    return { R: times(links[link].R, R), p: add(links[link].p, turn(links[link].R, p)) };
  }

  links(q = this.q) {
    const made = [];
    this.joints.forEach((joint, j) => {
      const above = made[joint.parent] ?? { R: [1, 0, 0, 0, 1, 0, 0, 0, 1], p: [0, 0, 0] };
      let R = times(above.R, joint.R), p = add(above.p, turn(above.R, joint.p));
      if (joint.slides) p = add(p, column(R, 2), q[j]);
      else {
        const [c, s] = [Math.cos(q[j]), Math.sin(q[j])];
        R = times(R, [c, -s, 0, s, c, 0, 0, 0, 1]);
      }
      made.push({ R, p });
    });
    return made;
  }

  // dq/dqa, a list of rows by joint.
  rates() {
    const n = this.qa.length, G = this.joints.map((_, j) => this.closure.G.slice(n * j, n * (j + 1)));
    const beside = (k, step) => this.direct(this.qa.map((v, i) => (i === k ? v + step : v)));
    for (const [j] of this.closure.polynomials ?? []) G[j] = this.qa.map((_, k) => (beside(k, 1e-6)[j] - beside(k, -1e-6)[j]) / 2e-6);
    if (this.closure.way === "direct") return G;
    const { unknown } = this.closure, r = this.gaps(this.q), J = this.slopes(this.q, this.joints.map((_, j) => j), r);
    const N = unknown.map((a) => unknown.map((b) => dot(J[a], J[b]) + (a === b ? 1e-12 * dot(J[a], J[a]) : 0)));
    const B = unknown.map((a) => this.qa.map((_, k) => -this.joints.reduce((sum, _, j) => sum + dot(J[a], J[j]) * (unknown.includes(j) ? 0 : G[j][k]), 0)));
    const found = solved(N, B);
    if (found) unknown.forEach((j, a) => { G[j] = found[a]; });
    return G;
  }

  // Linear and angular velocity of a point of a link, for unit rates of each coordinate with a torque row.
  twists(links, link, point, G) {
    return G[0].map((_, k) => {
      let [v, w] = [[0, 0, 0], [0, 0, 0]];
      for (let j = link; j >= 0; j = this.joints[j].parent) {
        const axis = column(links[j].R, 2);
        if (this.joints[j].slides) v = add(v, axis, G[j][k]);
        else {
          v = add(v, cross(axis, add(point, links[j].p, -1)), G[j][k]);
          w = add(w, axis, G[j][k]);
        }
      }
      return { v, w };
    });
  }

  // Rates of all joints by the coordinates c = B qa.
  coordinateRates() {
    const n = this.qa.length, B = this.qa.map((_, k) => this.mass.frame.slice(n * k, n * (k + 1)));
    const inverse = solved(B, this.qa.map((_, k) => this.qa.map((_, i) => (i === k ? 1 : 0))));
    return this.rates().map((row) => inverse[0].map((_, k) => row.reduce((sum, v, i) => sum + v * inverse[i][k], 0)));
  }

  // Mass matrix of the coordinates: bodies, by their kinetic energy, and rotors.
  massMatrix(links, G) {
    const n = this.qa.length, M = this.qa.map(() => this.qa.map(() => 0));
    links.forEach(({ R, p }, i) => {
      const [xx, xy, xz, yy, yz, zz, mx, my, mz, m] = this.mass.bodies.slice(10 * i, 10 * i + 10);
      const first = turn(R, [mx, my, mz]);
      const about = (w) => turn(R, turn([xx, xy, xz, xy, yy, yz, xz, yz, zz], turn([...column(R, 0), ...column(R, 1), ...column(R, 2)], w)));
      const t = this.twists(links, i, p, G);
      for (let a = 0; a < n; a++)
        for (let b = 0; b < n; b++)
          M[a][b] += m * dot(t[a].v, t[b].v) + dot(t[a].v, cross(t[b].w, first)) + dot(t[b].v, cross(t[a].w, first)) + dot(t[a].w, about(t[b].w));
    });
    for (const { weights, value } of this.mass.rotors)
      weights.forEach((u, a) => weights.forEach((v, b) => { M[a][b] += value * u * v; }));
    return M;
  }

  // Condition number of the handle's Jacobian, its columns J.
  condition(J) {
    const square = [0, 1, 2].map((i) => [0, 1, 2].map((k) => J.reduce((sum, { v }) => sum + v[i] * v[k], 0)));
    const sizes = eigen(square).map(({ value }) => Math.max(value, 0)).sort((a, b) => b - a);
    return Math.sqrt(sizes[0] / sizes[Math.min(J.length, 3) - 1]);
  }

  // Principal apparent masses at the handle, (J A^-1 J')^-1, largest first, or the reason why there are none.
  felt() {
    const links = this.links(), G = this.coordinateRates(), inner = this.mass.moving;
    const at = this.placed(links, this.handle).p, J = this.twists(links, this.handle.link, at, G);
    const worst = this.mass.worst;
    if (!(this.condition(inner.map((a) => J[a])) <= worst)) return { why: `The condition number of the handle's Jacobian is above ${worst} at this pose: no mass is shown.` };
    const indefinite = { why: "The mass matrix is not positive definite at this pose: no mass is shown." };
    const M = this.massMatrix(links, G), A = inner.map((a) => inner.map((b) => M[a][b]));
    const rates = solved(A, inner.map((a) => J[a].v));
    if (!rates) return indefinite;
    const mobility = [0, 1, 2].map((i) => [0, 1, 2].map((k) => inner.reduce((sum, a, r) => sum + J[a].v[i] * rates[r][k], 0)));
    const found = eigen(mobility).sort((a, b) => a.value - b.value);
    const most = found[2].value;
    if (found.some(({ value }) => value < -1e-9 * Math.abs(most)) || !(most > 0)) return indefinite;
    return { masses: found.filter(({ value }) => value > 1e-9 * most).map(({ value, vector }) => ({ mass: 1 / value, vector })) };
  }
}
