"use strict";
// The planar beam of this page: N straight pieces of angles a[j] against the clamp, joined by springs, under a dead
// force at s = at and its own weight. Its energy is least in equilibrium; the second derivatives are tridiagonal.
//   E = sum of 1/2 k (dq)^2 h  -  L h sum of P[j] . (cos a[j], sin a[j]),   dq = (a[j] - a[j-1]) / h - q0
// P[j]: all force that acts beyond the middle of piece j. Second order in h = 1 / N.

const PIECES = 200;

function interpolated(values, s) {
  const x = Math.min(Math.max(s, 0), 1) * (values.length - 1), i = Math.min(Math.floor(x), values.length - 2);
  return values[i] + (x - i) * (values[i + 1] - values[i]);
}

// `beam`: length_m, k_N_m, q0_rad, mass_kg_m (each from s = 0 to 1, evenly), masses (place and kg of each that rides on
// it), gravity_m_s2, clamp_rad.
function madeOf(beam) {
  const h = 1 / PIECES, k = [], q0 = [], gap = [], weight = [];
  for (let j = 0; j < PIECES; j++) {
    const s = j ? j * h : 0.25 * h;
    gap.push(j ? h : 0.5 * h);
    k.push(interpolated(beam.k_N_m, s));
    q0.push(interpolated(beam.q0_rad, s));
  }
  let mass = 0;
  for (let j = PIECES - 1; j >= 0; j--) {
    const own = interpolated(beam.mass_kg_m, (j + 0.5) * h) * beam.length_m * h;
    const riding = beam.masses.reduce((sum, [s, m]) => sum + m * Math.min(Math.max(s / h - j, 0), 1), 0);
    weight[j] = beam.gravity_m_s2.map((g) => g * (mass + 0.5 * own + riding));
    mass += own;
  }
  return { h, k, q0, gap, weight, length: beam.length_m, clamp: beam.clamp_rad };
}

function loadsOf(made, force, at) {
  return made.weight.map(([x, y], j) => {
    const share = Math.min(Math.max(at / made.h - j, 0), 1);
    return [x + share * force[0], y + share * force[1]];
  });
}

function strain(made, a, j) {
  return (a[j] - (j ? a[j - 1] : made.clamp)) / made.gap[j] - made.q0[j];
}

function energyOf(made, loads, a) {
  let sum = 0;
  for (let j = 0; j < PIECES; j++) {
    sum += 0.5 * made.k[j] * made.gap[j] * strain(made, a, j) ** 2;
    sum -= made.length * made.h * (loads[j][0] * Math.cos(a[j]) + loads[j][1] * Math.sin(a[j]));
  }
  return sum;
}

// Diagonal, the entries beside it, and minus the slope of the energy.
function linearised(made, loads, a) {
  const main = [], beside = [], down = [], lh = made.length * made.h;
  for (let j = 0; j < PIECES; j++) {
    const [x, y] = loads[j], sin = Math.sin(a[j]), cos = Math.cos(a[j]);
    const last = j === PIECES - 1;
    main.push(made.k[j] / made.gap[j] + (last ? 0 : made.k[j + 1] / made.gap[j + 1]) + lh * (x * cos + y * sin));
    if (!last) beside.push(-made.k[j + 1] / made.gap[j + 1]);
    down.push(-made.k[j] * strain(made, a, j) + (last ? 0 : made.k[j + 1] * strain(made, a, j + 1))
      - lh * (x * sin - y * cos));
  }
  return { main, beside, down };
}

// Solves the tridiagonal equations; null where they are not positive definite.
function solvedFor(main, beside, right) {
  const d = main.slice(), x = right.slice();
  for (let j = 0; j < d.length; j++) {
    if (j) {
      const factor = beside[j - 1] / d[j - 1];
      d[j] -= factor * beside[j - 1];
      x[j] -= factor * x[j - 1];
    }
    if (!(d[j] > 0)) return null;
  }
  for (let j = d.length - 1; j >= 0; j--) x[j] = (x[j] - (j + 1 < d.length ? beside[j] * x[j + 1] : 0)) / d[j];
  return x;
}

// Angles in equilibrium, from `start` on (null: from rest, the load in steps). It only goes down in energy.
function equilibrium(made, force, at, start) {
  let a = start || new Array(PIECES).fill(made.clamp);
  for (const part of start ? [1] : [0.1, 0.25, 0.5, 0.75, 1]) {
    const loads = loadsOf(made, force.map((f) => part * f), at);
    let shift = 0;
    for (let step = 0; step < 200; step++) {
      const now = linearised(made, loads, a), scale = Math.max(...now.main.map(Math.abs));
      const move = solvedFor(now.main.map((value) => value + shift), now.beside, now.down);
      if (move === null) { shift = Math.max(4 * shift, 1e-6 * scale); continue; }
      const largest = Math.max(...move.map(Math.abs)), before = energyOf(made, loads, a);
      let taken = Math.min(1, 0.5 / largest), next = a;
      for (let halved = 0; halved < 30; halved++, taken /= 2) {
        next = a.map((angle, j) => angle + taken * move[j]);
        if (energyOf(made, loads, next) <= before + 1e-15 * Math.abs(before)) break;
      }
      a = next;
      shift = shift > 1e-9 * scale ? shift / 8 : 0;
      if (largest < 1e-9) break;
    }
  }
  return a;
}

// Where s is on the beam, m.
function placeOf(made, a, s) {
  const out = [0, 0];
  for (let j = 0; j < PIECES; j++) {
    const share = made.length * made.h * Math.min(Math.max(s / made.h - j, 0), 1);
    out[0] += share * Math.cos(a[j]);
    out[1] += share * Math.sin(a[j]);
  }
  return out;
}

function lineOf(made, a) {
  const points = [[0, 0]];
  for (let j = 0; j < PIECES; j++) {
    const [x, y] = points[j], step = made.length * made.h;
    points.push([x + step * Math.cos(a[j]), y + step * Math.sin(a[j])]);
  }
  return points;
}

// d place / d force, (2, 2) m/N; null where the shape is not stable.
function complianceOf(made, a, force, at) {
  const now = linearised(made, loadsOf(made, force, at), a);
  const turns = [0, 1].map((axis) => a.map((angle, j) => made.length * made.h
    * Math.min(Math.max(at / made.h - j, 0), 1) * (axis ? Math.cos(angle) : -Math.sin(angle))));
  const moved = turns.map((turn) => solvedFor(now.main, now.beside, turn));
  if (moved.includes(null)) return null;
  return turns.map((turn) => moved.map((move) => turn.reduce((sum, value, j) => sum + value * move[j], 0)));
}

// The force of a soft spring (N/m) from the beam's place `at` to `goal`, and the shape under it; |force| <= most.
function pulledTo(made, goal, at, spring, most, force, start) {
  let a = equilibrium(made, force, at, start);
  for (let step = 0; step < 12; step++) {
    const here = placeOf(made, a, at);
    const off = [0, 1].map((i) => force[i] - spring * (goal[i] - here[i]));
    const give = complianceOf(made, a, force, at) || [[0, 0], [0, 0]];
    const m = [[1 + spring * give[0][0], spring * give[0][1]], [spring * give[1][0], 1 + spring * give[1][1]]];
    const det = m[0][0] * m[1][1] - m[0][1] * m[1][0];
    const move = [(m[1][1] * off[0] - m[0][1] * off[1]) / det, (m[0][0] * off[1] - m[1][0] * off[0]) / det];
    let next = [force[0] - move[0], force[1] - move[1]];
    const size = Math.hypot(...next);
    if (size > most) next = next.map((f) => f * most / size);
    const moved = Math.hypot(next[0] - force[0], next[1] - force[1]);
    force = next;
    a = equilibrium(made, force, at, a);
    if (moved < 1e-4 * most) break;
  }
  return { force, a };
}
