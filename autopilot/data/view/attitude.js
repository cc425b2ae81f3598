// Artificial horizon and compass. Nothing here knows the page: a context, a size, figures and colours go in.
// Attitude is that of FRD axes: roll positive with the right side down, pitch positive with the nose up.
import { arrow, circle, clear, fill, hull, number, stroke, text } from "./ink.js";

const SPAN_RAD = 0.6; // from the middle of the horizon to its rim
const LADDER_DEG = [-30, -20, -10, 10, 20, 30];
const BANK_DEG = [-60, -30, -20, -10, 0, 10, 20, 30, 60];
const STILL_M_S = 0.005, CLOSE_M = 0.05; // a slower current and a nearer goal have no direction
const AHEAD_M = 0.3; // the route's bearing is to its first point that is farther away

const rad = (degrees) => (degrees * Math.PI) / 180;
const bearing = ([n, e], [n1, e1]) => Math.atan2(e1 - e, n1 - n);

// A bearing in three digits, as on a compass.
export const bearingText = (angle) => `${String((Math.round((angle * 180) / Math.PI) + 720) % 360).padStart(3, "0")}°`;

// What both show; null without an attitude. Without a place that of the AHRS.
export function attitudeOf({ estimate, measured, goal, control }) {
  if (measured && measured.rpy_rad) {
    const [roll, pitch, heading] = measured.rpy_rad;
    return { roll, pitch, heading, goal: null, route: null, current: null };
  }
  if (!estimate) return null;
  const here = estimate.pos_ned_m, [roll, pitch, heading] = estimate.rpy_rad, [u, v] = estimate.current_ned_m_s;
  const far = (place) => Math.hypot(place[0] - here[0], place[1] - here[1]);
  const next = control && control.route_ned_m.find((place) => far(place) > AHEAD_M);
  return {
    roll, pitch, heading,
    goal: goal && { bearing: far(goal.pos_ned_m) < CLOSE_M ? null : bearing(here, goal.pos_ned_m), distance_m: far(goal.pos_ned_m) },
    route: next ? bearing(here, next) : null,
    current: { bearing: Math.atan2(v, u), speed_m_s: Math.hypot(u, v) },
  };
}

// Lines of words with the colour and the mark (as of a legend) that the dials show them by.
export function attitudeWords(facts) {
  if (!facts) return { horizon: [["no estimate"]], compass: [["no estimate"]] };
  const turn = (angle) => `${number((angle * 180) / Math.PI, 1)}°`, { goal, route, current } = facts;
  const compass = [[`heading ${bearingText(facts.heading)}`, "body", "line"]];
  if (goal) compass.push([`goal ${goal.bearing === null ? "" : `${bearingText(goal.bearing)}, `}${number(goal.distance_m, 2)} m`, "goal", "line"]);
  if (route !== null) compass.push([`route ${bearingText(route)}`, "route", "dotted"]);
  const speed = current && current.speed_m_s;
  if (current) compass.push([`current ${speed < STILL_M_S ? "" : `to ${bearingText(current.bearing)}, `}${number(speed, 2)} m/s`, "felt", "line"]);
  return { horizon: [[`roll ${turn(facts.roll)}`], [`pitch ${turn(facts.pitch)}`]], compass };
}

// Points of the outer world as the vehicle sees them: to the right and up from where it looks, in rad, onto the dial.
export function seenAt({ roll, pitch }, [x, y], reach) {
  const c = Math.cos(roll), s = Math.sin(roll), k = reach / SPAN_RAD;
  return ([right, up]) => [x + k * (c * right - s * (up - pitch)), y - k * (s * right + c * (up - pitch))];
}

export function drawHorizon(ctx, width, height, facts, colors) {
  const middle = [width / 2, height / 2], rim = 0.5 * Math.min(width, height) - 2, reach = rim - 9;
  clear(ctx, width, height, colors);
  circle(ctx, middle, rim, colors.weak, 1);
  const bank = (angle, r) => [middle[0] + r * Math.sin(angle), middle[1] - r * Math.cos(angle)];
  for (const mark of BANK_DEG) stroke(ctx, [bank(rad(mark), rim), bank(rad(mark), reach + (mark % 30 ? 4 : 1))], colors.ink, 1.2);
  if (!facts) return;
  const at = seenAt(facts, middle, reach), far = 4 + Math.abs(facts.pitch);
  ctx.save();
  ctx.beginPath();
  ctx.arc(...middle, reach, 0, 2 * Math.PI);
  ctx.clip();
  fill(ctx, [[-far, 0], [far, 0], [far, 2 * far], [-far, 2 * far]].map(at), colors.above);
  fill(ctx, [[-far, 0], [far, 0], [far, -2 * far], [-far, -2 * far]].map(at), colors.below);
  stroke(ctx, [[-far, 0], [far, 0]].map(at), colors.ink, 2);
  for (const mark of LADDER_DEG) {
    const half = mark % 20 ? 0.07 : 0.13;
    stroke(ctx, [[-half, rad(mark)], [half, rad(mark)]].map(at), colors.ink, 1.2);
    if (mark % 20 === 0) text(ctx, String(mark), ...at([half + 0.04, rad(mark)]), colors.ink);
  }
  ctx.restore();
  circle(ctx, middle, reach, colors.weak, 1);
  // The pointer goes with the world, over a scale that is the vehicle's.
  fill(ctx, [bank(-facts.roll, reach), bank(-facts.roll - 0.08, reach - 9), bank(-facts.roll + 0.08, reach - 9)], colors.ink);
  const [x, y] = middle, wing = 0.5 * reach;
  for (const side of [-1, 1]) stroke(ctx, [[x + side * wing, y], [x + 0.4 * side * wing, y], [x + 0.4 * side * wing, y + 5]], colors.body, 3);
  circle(ctx, middle, 2.5, colors.body, 1, true);
}

// North is up.
export function drawCompass(ctx, width, height, facts, colors) {
  const middle = [width / 2, height / 2], rim = 0.5 * Math.min(width, height) - 7, inner = rim - 19;
  clear(ctx, width, height, colors);
  circle(ctx, middle, rim, colors.weak, 1);
  const at = (angle, r) => [middle[0] + r * Math.sin(angle), middle[1] - r * Math.cos(angle)];
  for (let mark = 0; mark < 360; mark += 10) stroke(ctx, [at(rad(mark), rim), at(rad(mark), rim - (mark % 30 ? 3 : 6))], colors.weak, 1);
  ["N", "E", "S", "W"].forEach((name, index) => text(ctx, name, ...at(rad(90 * index), rim - 13), colors.ink, "center"));
  if (!facts) return;
  const { heading, goal, route, current } = facts;
  if (route !== null) stroke(ctx, [at(route, 0.34 * rim), at(route, inner)], colors.route, 2, false, [2, 3]);
  stroke(ctx, [at(heading, 0.3 * rim), at(heading, rim)], colors.body, 2);
  const shape = hull([0, 0], heading, 0.3 * rim).map(([n, e]) => [middle[0] + e, middle[1] - n]);
  fill(ctx, shape, colors.tube);
  fill(ctx, [shape[0], shape[1], shape[4]], colors.nose);
  stroke(ctx, shape, colors.body, 1.5, true);
  if (goal && goal.bearing !== null) circle(ctx, at(goal.bearing, rim), 5, colors.goal, 2);
  if (current && current.speed_m_s >= STILL_M_S) arrow(ctx, at(current.bearing + Math.PI, 0.5 * rim), at(current.bearing, 0.62 * rim), colors.felt, 2.5);
}
