// What was shown in the last minutes: frames to go back to, and strip charts of them. Nothing here knows the page.
import { clear, number, stroke, text } from "./ink.js";

export const KEPT = 6000; // frames: ten minutes of ten a second
const SPARE = KEPT / 4; // beyond that the oldest are dropped at once
const KEPT_SLOW = 600; // flows and pictures, one a second
const KEPT_MESSAGES = 3000, SHOWN_MESSAGES = 60, KEPT_SCENES = 20;
const TRAIL = 1500, TRAIL_STEP_M = 0.01;
const COLUMNS = ["t", "north", "east", "depth", "heading", "speed", "least", "most", "error", "sigma", "solve"];

// A chart: lines by column, a band between two, bounds by the scene. `turns`: no line across north.
export const CHARTS = [
  { name: "Depth", unit: "m", digits: 2, lines: [["depth", "body"]], down: true, bounds: ({ parameters: p }) => [p.DEPTH_MIN, p.DEPTH_MAX].filter((v) => v > 0) },
  { name: "Heading", unit: "°", digits: 0, lines: [["heading", "body"]], turns: true, bounds: () => [] },
  { name: "Planar speed", unit: "m/s", digits: 2, lines: [["speed", "body"]], least: 0, bounds: ({ limits }) => [limits.planar_speed_m_s] },
  { name: "Thrust", more: ", least and most", unit: "N", digits: 1, lines: [["least", "horizon"], ["most", "body"]], bounds: ({ limits }) => [-limits.thrust_n, limits.thrust_n] },
  { name: "Position error", more: " and 3 sigma", other: "Position, 3 sigma", unit: "mm", digits: 1, lines: [["error", "body"], ["sigma", "horizon"]], least: 0, bounds: () => [] },
  { name: "Solve time", unit: "ms", digits: 1, lines: [["solve", "body"]], least: 0, bounds: ({ limits }) => [limits.solve_ms] },
];

// Of one frame, as COLUMNS.
function values({ t_s, estimate: nav, measured, truth, thrust_n, control }) {
  const { depth_m: depth, rpy_rad: rpy } = measured ?? {}, heading = (yaw) => ((yaw * 180) / Math.PI + 360) % 360;
  const lone = [t_s, NaN, NaN, depth ?? NaN, rpy ? heading(rpy[2]) : NaN, NaN];
  const thrust = thrust_n.length ? [Math.min(...thrust_n), Math.max(...thrust_n)] : [NaN, NaN];
  const solve = control ? control.solve_ms : NaN;
  if (!nav || nav.health === "INVALID") return [...lone, ...thrust, NaN, NaN, solve];
  const [u, v] = nav.vel_water_frd_m_s;
  const error = truth ? 1e3 * Math.hypot(...truth.pos_ned_m.map((value, axis) => value - nav.pos_ned_m[axis])) : NaN;
  return [t_s, ...nav.pos_ned_m, heading(nav.rpy_rad[2]), Math.hypot(u, v), ...thrust, error, 3e3 * Math.max(...nav.sigma_pos_m), solve];
}

// The first index in rising times whose time is above t.
function above(times, count, t) {
  let [low, high] = [0, count];
  while (low < high) {
    const middle = (low + high) >> 1;
    if (times[middle] <= t) low = middle + 1;
    else high = middle;
  }
  return low;
}

export class History {
  // `frames`: kept whole to go back to them, as text, which takes a tenth of the memory.
  constructor(frames = true) { this.whole = frames; this.clear(); }

  clear() {
    this.columns = Object.fromEntries(COLUMNS.map((name) => [name, new Float64Array(KEPT + SPARE)]));
    Object.assign(this, { count: 0, frames: [], messages: [], scenes: new Map(), flows: [], pictures: [], before: [], passed: [], passed_s: [] });
  }

  get begin() { return this.count ? this.columns.t[0] : 0; }
  get end() { return this.count ? this.columns.t[this.count - 1] : 0; }

  // `before`: where the vehicle had been when the history began.
  add(frame, scene, before = []) {
    if (this.count && frame.t_s < this.end) this.clear();
    if (!this.count) this.before = before;
    const newest = this.messages.length ? this.messages[this.messages.length - 1].number : 0;
    this.messages.push(...frame.messages.filter((message) => message.number > newest));
    if (this.messages.length > KEPT_MESSAGES) this.messages.splice(0, this.messages.length - KEPT_MESSAGES);
    if (this.count && frame.t_s === this.end) return;
    if (this.count === KEPT + SPARE) this.drop();
    values(frame).forEach((value, place) => { this.columns[COLUMNS[place]][this.count] = value; });
    this.count += 1;
    if (!this.whole) return;
    if (frame.estimate && frame.estimate.health !== "INVALID") this.pass(frame.t_s, frame.estimate.pos_ned_m);
    this.frames.push(JSON.stringify({ ...frame, messages: [] }));
    if (!this.scenes.has(frame.scene)) {
      this.scenes.set(frame.scene, scene);
      if (this.scenes.size > KEPT_SCENES) this.scenes.delete(this.scenes.keys().next().value);
    }
  }

  drop() {
    this.before = [];
    for (const column of Object.values(this.columns)) column.copyWithin(0, SPARE);
    this.frames.splice(0, SPARE);
    this.count -= SPARE;
    const gone = above(this.passed_s, this.passed_s.length, this.begin);
    for (const list of [this.passed, this.passed_s]) list.splice(0, gone);
  }

  // Of things that come more seldom than frames: one for each second.
  addSlow(list, one) {
    const last = list[list.length - 1];
    if (last && one.t_s - last.t_s < 0.95) return;
    list.push(one);
    if (list.length > KEPT_SLOW) list.shift();
  }

  // Everything that was shown then, null before the first frame.
  moment(t_s) {
    if (!this.count) return null;
    const index = Math.max(above(this.columns.t, this.count, t_s) - 1, 0), frame = JSON.parse(this.frames[index]);
    const last = (list) => list.filter((one) => one.t_s <= frame.t_s).pop() ?? null, picture = last(this.pictures);
    return {
      frame: { ...frame, messages: messagesUpTo(this.messages, frame.t_s) },
      scene: this.scenes.get(frame.scene) ?? null, trail: this.trail(frame.t_s), flow: last(this.flows), picture, image: picture && picture.image,
    };
  }

  // Where it had been until then, oldest first.
  trail(t_s) {
    const end = above(this.passed_s, this.passed_s.length, t_s), kept = this.passed.slice(Math.max(end - TRAIL, 0), end);
    return kept.length < TRAIL ? [...this.before.slice(kept.length - TRAIL), ...kept] : kept;
  }

  pass(t_s, place) {
    const last = this.passed[this.passed.length - 1];
    if (last && Math.hypot(...place.map((value, axis) => value - last[axis])) <= TRAIL_STEP_M) return;
    this.passed.push(place);
    this.passed_s.push(t_s);
  }
}

export const messagesUpTo = (messages, t_s) => messages.filter((message) => message.t_s <= t_s).slice(-SHOWN_MESSAGES);

// Charts

const MORE_PX = 200; // from that width on the name says all lines
const PAD = { left: 34, right: 8, top: 18, bottom: 14 }, FONT_PX = 11;

function layout(width, height) {
  const columns = width >= 900 ? 6 : width >= 540 ? 3 : 2, rows = CHARTS.length / columns;
  const [w, h] = [width / columns, height / rows];
  return CHARTS.map((chart, place) => {
    const x = (place % columns) * w, y = Math.floor(place / columns) * h;
    return { chart, x: x + PAD.left, y: y + PAD.top, w: w - PAD.left - PAD.right, h: h - PAD.top - PAD.bottom };
  });
}

// The time under a point.
export function timeAt(width, height, [x, y], [from, to]) {
  const boxes = layout(width, height), off = (box) => Math.max(box.x - x, x - box.x - box.w, 0) + 10 * Math.max(box.y - PAD.top - y, y - box.y - box.h - PAD.bottom, 0);
  const box = boxes.reduce((best, one) => (off(one) < off(best) ? one : best));
  return from + Math.min(Math.max((x - box.x) / box.w, 0), 1) * (to - from);
}

// A column as the least and the most of each pixel: as few points as the chart is wide, however long the history is.
function outline(times, column, first, last, from, perSecond, turns) {
  const runs = [];
  let run = null, pixel = -1, low = 0, high = 0, end = 0;
  const put = () => { if (run && pixel >= 0) { run.push([pixel, low], [pixel, high], [pixel, end]); pixel = -1; } };
  for (let k = first; k < last; k += 1) {
    const value = column[k], x = Math.round((times[k] - from) * perSecond);
    if (Number.isNaN(value) || (turns && run && Math.abs(value - end) > 180)) { put(); run = null; if (Number.isNaN(value)) continue; }
    if (!run) { run = []; runs.push(run); pixel = -1; }
    if (x !== pixel) { put(); run.push([x, value]); pixel = x; low = high = value; }
    low = Math.min(low, value);
    high = Math.max(high, value);
    end = value;
  }
  put();
  return runs;
}

// What a chart spans, and the two values that are written beside it: bounds, where there are some.
function range({ lines, bounds, least, turns }, { columns }, first, last, scene) {
  if (turns) return { low: 0, high: 360, ends: [0, 360] };
  let [low, high] = [Infinity, -Infinity];
  for (const [name] of lines) for (let k = first; k < last; k += 1) {
    const value = columns[name][k];
    if (value < low) low = value;
    if (value > high) high = value;
  }
  const limits = bounds(scene);
  for (const bound of limits) { low = Math.min(low, bound); high = Math.max(high, bound); }
  if (least !== undefined) low = least;
  if (!(high > low)) [low, high] = low === Infinity ? [0, 1] : [low - 0.5, low + 0.5];
  const pad = 0.06 * (high - low);
  const ends = limits.length > 1 ? limits : [low, limits.length ? limits[0] : high];
  return { low: low - (least === undefined ? pad : 0), high: high + pad, ends };
}

// The lines as they were drawn last, and of what: a time that is dragged through them leaves them as they are.
const drawn = { of: [], canvas: null };

// `frame`: what is shown at the time `at`, whose values stand beside the names; `label`: how a time is written.
export function drawCharts(ctx, width, height, { history, scene, frame, from, to, at, label }, colors) {
  const { t } = history.columns, first = Math.max(above(t, history.count, from) - 1, 0), last = above(t, history.count, to);
  const { width: across, height: high } = ctx.canvas, ends = [label(from), label(to)];
  const of = [history, scene, colors, across, high, width, from, to, ...ends, t[first], first, last];
  if (!across || !high) return;
  if (of.some((value, place) => value !== drawn.of[place])) {
    Object.assign(drawn, { of, canvas: new OffscreenCanvas(across, high) });
    const lines = drawn.canvas.getContext("2d");
    lines.scale(across / width, high / height);
    drawLines(lines, width, height, { history, scene, first, last, from, to, ends }, colors);
  }
  ctx.drawImage(drawn.canvas, 0, 0, width, height);
  const here = frame ? Object.fromEntries(values(frame).map((value, place) => [COLUMNS[place], value])) : {};
  for (const { chart, x, y, w, h } of layout(width, height)) {
    const now = x + w * Math.min(Math.max((at - from) / Math.max(to - from, 1e-9), 0), 1);
    stroke(ctx, [[now, y], [now, y + h]], colors.ink, 1);
    const shown = chart.lines.map(([name]) => here[name]).filter((value) => Number.isFinite(value));
    const name = chart.other && !Number.isFinite(here.error) ? chart.other : chart.name + ((w > MORE_PX && chart.more) || ""); // no truth, no error
    text(ctx, name, x, y - 9, colors.weak, "left", FONT_PX);
    text(ctx, `${shown.length ? shown.map((value) => number(value, chart.digits)).join(", ") : "–"} ${chart.unit}`, x + w, y - 9, colors.ink, "right", FONT_PX);
  }
}

function drawLines(ctx, width, height, { history, scene, first, last, from, to, ends: [begin, end] }, colors) {
  clear(ctx, width, height, colors);
  for (const { chart, x, y, w, h } of layout(width, height)) {
    const { low, high, ends } = range(chart, history, first, last, scene), perSecond = w / Math.max(to - from, 1e-9);
    const level = (value) => y + h * (chart.down ? (value - low) / (high - low) : (high - value) / (high - low));
    const within = (points) => points.map(([px, value]) => [x + Math.min(Math.max(px, 0), w), level(value)]);
    stroke(ctx, [[x, y], [x, y + h], [x + w, y + h]], colors.grid, 1);
    for (const bound of chart.bounds(scene)) stroke(ctx, [[x, level(bound)], [x + w, level(bound)]], colors.fence, 1, false, [5, 4]);
    for (const [name, color] of chart.lines) {
      for (const run of outline(history.columns.t, history.columns[name], first, last, from, perSecond, chart.turns)) stroke(ctx, within(run), colors[color], 1.5);
    }
    for (const value of ends) text(ctx, number(value, value >= 100 ? 0 : chart.digits && 1), x - 4, level(value), colors.weak, "right", FONT_PX);
    text(ctx, begin, x, y + h + 7, colors.weak, "left", FONT_PX);
    text(ctx, end, x + w, y + h + 7, colors.weak, "right", FONT_PX);
  }
}
