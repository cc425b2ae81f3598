// Drawing on 2D contexts. Nothing here knows the page: a context, a size, the data and colours go in.
// World: north up, east to the right in the plan; east to the right, depth down in the side view.
import { ageText } from "./ages.js";
import { arrow, circle, clear, fill, hull, path, stroke, text, tubeEdges } from "./ink.js";
import { drawDimensions } from "./margins.js";
import { STRIP, extent, floorDepth, flowArrows, flowScale, gridStep, planView } from "./plan.js";

export const DARK = {
  back: "#18222c", ink: "#e4ebf1", weak: "#93a4b3", wall: "#c3d0db", fence: "#ff6b6b", margin: "rgba(255,107,107,.16)",
  water: "#1d2c39", solid: "#7d8a96", place: "#4cc38a", goal: "#4cc38a", route: "#c79bff", horizon: "#f0a83c",
  tube: "rgba(240,168,60,.35)", trail: "#4fb3e8", truth: "#f5f7fa", body: "#4fb3e8", flow: "#5d86a6", felt: "#2fd6c8", track: "#ff9de0",
  grid: "#2a3946", pillar: "rgba(125,138,150,.4)", nose: "rgba(79,179,232,.75)", above: "#1f4a68", below: "#4a3a26",
};
export const LIGHT = {
  back: "#ffffff", ink: "#1b2733", weak: "#566573", wall: "#33414e", fence: "#c4262e", margin: "rgba(196,38,46,.12)",
  water: "#eef5fa", solid: "#66737f", place: "#157344", goal: "#157344", route: "#7a3fc0", horizon: "#b86a00",
  tube: "rgba(184,106,0,.3)", trail: "#0b6fa4", truth: "#111111", body: "#0b6fa4", flow: "#5689ab", felt: "#00857c", track: "#b3128a",
  grid: "#dde5eb", pillar: "rgba(102,115,127,.4)", nose: "rgba(11,111,164,.75)", above: "#cfe6f5", below: "#ead9c0",
};
// What stands for what: words, colour, and how it is drawn (line, dashed, dotted, area).
export const LEGEND = [
  ["vehicle (nose filled), track", "trail", "line"], ["truth", "truth", "line"], ["prediction", "horizon", "line"],
  ["its tube", "tube", "area"], ["route", "route", "dotted"], ["fence, depth limits", "fence", "dashed"],
  ["kept free", "margin", "area"], ["obstacle", "solid", "area"], ["waypoint, acceptance, heading", "place", "dashed"],
  ["goal", "goal", "line"], ["current", "flow", "line"], ["estimated current", "felt", "line"], ["reported obstacle", "track", "dotted"],
];

const LEAST_PX = 7; // radius of the vehicle, at least

// Everything within its radius of a way, as one shape: circles and what lies between them, all turned the same way.
function fillTube(ctx, points, radii, color) {
  ctx.beginPath();
  points.forEach(([x, y], index) => {
    const r = radii[index];
    ctx.moveTo(x + r, y);
    ctx.arc(x, y, r, 0, 2 * Math.PI);
    if (!index) return;
    const [x0, y0] = points[index - 1], r0 = radii[index - 1], length = Math.hypot(x - x0, y - y0) || 1;
    const [u, v] = [(y - y0) / length, (x0 - x) / length];
    ctx.moveTo(x0 + r0 * u, y0 + r0 * v);
    for (const [px, py] of [[x + r * u, y + r * v], [x - r * u, y - r * v], [x0 - r0 * u, y0 - r0 * v]]) ctx.lineTo(px, py);
    ctx.closePath();
  });
  ctx.fillStyle = color;
  ctx.fill();
}

// The same with its two edges, which can be told from the ground.
function drawTube(ctx, points, radii, colors) {
  fillTube(ctx, points, radii, colors.tube);
  for (const edge of tubeEdges(points, radii, 0.5)) stroke(ctx, edge, colors.horizon, 0.8);
}

// North in the strip above the plan; in that below the key of the current and the scale, which is one square of the grid.
function margins(ctx, width, height, view, { told, reach, old }, colors) {
  const at = view.turned ? [12, STRIP / 2] : [18, STRIP - 4], up = view.turned ? [34, STRIP / 2] : [18, 4];
  arrow(ctx, at, up, colors.ink, 1.5);
  text(ctx, "N", view.turned ? 40 : 26, STRIP / 2, colors.ink);
  const low = height - STRIP / 2, key = told * reach * view.scale;
  arrow(ctx, [12, low], [12 + key, low], old ? colors.solid : colors.flow, 1.5);
  text(ctx, `${Number(told.toPrecision(1))} m/s${old ? `, ${old} old` : ""}`, 18 + key, low, colors.weak);
  const metres = gridStep(view.scale), length = metres * view.scale, x = width - 12 - length;
  stroke(ctx, [[x, low - 4], [x, low], [x + length, low], [x + length, low - 4]], colors.ink, 1.5);
  text(ctx, `${Number(metres.toPrecision(1))} m`, x - 6, low, colors.ink, "right");
}

function drawGrid(ctx, view, colors) {
  const step = gridStep(view.scale), { n0, n1, e0, e1 } = view.box;
  for (let n = Math.ceil(n0 / step) * step; n <= n1; n += step) stroke(ctx, [[n, e0], [n, e1]].map(view.at), colors.grid, 1);
  for (let e = Math.ceil(e0 / step) * step; e <= e1; e += step) stroke(ctx, [[n0, e], [n1, e]].map(view.at), colors.grid, 1);
}

// Everything in small, with what the plan shows of it.
function miniMap(ctx, width, height, scene, frame, view, colors) {
  const { n0, n1, e0, e1 } = view.all, [across, high] = view.turned ? [n1 - n0, e1 - e0] : [e1 - e0, n1 - n0];
  const scale = Math.min((0.3 * width) / across, (0.3 * (height - 2 * STRIP)) / high, 160 / Math.max(across, high));
  const [w, h] = [scale * across, scale * high], [x, y] = [width - w - 8, STRIP + 4];
  const at = ([n, e]) => (view.turned ? [x + (n - n0) * scale, y + (e - e0) * scale] : [x + (e - e0) * scale, y + (n1 - n) * scale]);
  const frameOf = (left, right, low, high) => [[right, left], [right, high], [low, high], [low, left]];
  fill(ctx, frameOf(e0, n1, n0, e1).map(at), colors.back);
  ctx.save();
  path(ctx, frameOf(e0, n1, n0, e1).map(at), true);
  ctx.clip();
  if (scene.tank_m.length) stroke(ctx, scene.tank_m.map(at), colors.weak, 1, true);
  for (const shape of scene.fence) stroke(ctx, shape.corners_m.map(at), colors.fence, 1, true, [3, 2]);
  for (const solid of frame ? frame.solids : []) circle(ctx, at(solid.center_m), Math.max(solid.radius_m * scale, 1.5), colors.solid, 1, true);
  for (const place of scene.places) circle(ctx, at(place.pos_ned_m), 2, colors.place, 1, true);
  if (frame && frame.estimate) circle(ctx, at(frame.estimate.pos_ned_m), 3, colors.body, 1, true);
  const seen = view.box;
  stroke(ctx, frameOf(seen.e0, seen.n1, seen.n0, seen.e1).map(at), colors.ink, 2, true);
  ctx.restore();
  stroke(ctx, frameOf(e0, n1, n0, e1).map(at), colors.weak, 1, true);
}

// Colours of a vehicle that is not where it is drawn any more.
export const faded = (colors) => ({ ...colors, body: colors.weak, nose: colors.weak, felt: colors.weak, tube: "rgba(128,128,128,.2)" });

// `camera`: of plan.js. `flowOld`: how old the field of the current is in words, "" while it is of now.
export function drawPlan(ctx, width, height, { scene, frame, flow, trail, moving, lost, flowOld, camera, margins: dimensioned }, colors) {
  const view = planView(width, height, extent(scene, frame), camera), { at, scale } = view;
  const { told, reach: whole } = flowScale(flow, view.all), reach = (whole * view.fit) / scale; // as long at any zoom
  clear(ctx, width, height, colors);
  ctx.save();
  path(ctx, [[0, STRIP], [width, STRIP], [width, height - STRIP], [0, height - STRIP]], true);
  ctx.clip();
  drawWorld(ctx, view, told, reach, { scene, frame, flow, trail, moving, lost, flowOld }, colors);
  if (dimensioned && frame && !lost) drawDimensions(ctx, view, scene, frame, colors);
  ctx.restore();
  margins(ctx, width, height, view, { told, reach, old: flowOld }, colors);
  if (scale > 1.05 * view.fit) miniMap(ctx, width, height, scene, frame, view, colors);
  return view;
}

function drawWorld(ctx, view, told, reach, { scene, frame, flow, trail, moving, lost, flowOld }, colors) {
  const { at, scale } = view, many = (points) => points.map(at);
  if (scene.tank_m.length) fill(ctx, many(scene.tank_m), colors.water);
  drawGrid(ctx, view, colors);
  for (const [n, e, u, v] of flow ? flowArrows(flow, view, 0.9 * told * reach * scale) : []) {
    const [dn, de] = [0.5 * reach * u, 0.5 * reach * v];
    arrow(ctx, at([n - dn, e - de]), at([n + dn, e + de]), flowOld ? colors.solid : colors.flow, 1.2);
  }
  // The vehicle's centre stays out of what is kept free, and with it the tube round the prediction.
  for (const shape of scene.fence) {
    const corners = many(shape.corners_m);
    ctx.save();
    path(ctx, corners, true);
    if (shape.inclusion) ctx.clip();
    stroke(ctx, corners, colors.margin, 2 * scene.body_radius_m * scale, true);
    ctx.restore();
    if (!shape.inclusion) fill(ctx, corners, colors.margin);
  }
  if (scene.tank_m.length) stroke(ctx, many(scene.tank_m), colors.wall, 2.5, true);
  for (const solid of frame ? frame.solids : []) {
    if (solid.corners_m.length) fill(ctx, many(solid.corners_m), colors.solid);
    else circle(ctx, at(solid.center_m), solid.radius_m * scale, colors.solid, 1, true);
    text(ctx, String(solid.number), ...at(solid.center_m), colors.back, "center");
  }
  // Over walls and obstacles, which a fence often follows.
  for (const shape of scene.fence) stroke(ctx, many(shape.corners_m), colors.fence, 1.5, true, [6, 4]);
  if (moving) circle(ctx, at(moving.place), moving.radius_m * scale, colors.solid, 2, false, [4, 3]);
  for (const track of frame ? frame.tracks : []) {
    const [n, e] = track.pos_ned_m, [u, v] = track.vel_ned_m_s, color = track.age_s > scene.ages.track_s ? colors.weak : colors.track;
    circle(ctx, at([n, e]), track.radius_m * scale, color, 1.5, false, [3, 3]);
    arrow(ctx, at([n, e]), at([n + 2 * u, e + 2 * v]), color, 1.5);
    if (track.age_s > scene.ages.track_s) text(ctx, `${ageText(track.age_s)} old`, at([n, e])[0], at([n, e])[1], color, "center");
  }
  for (const place of scene.places) {
    const here = at(place.pos_ned_m);
    circle(ctx, here, place.accept_radius_m * scale, colors.place, 1.2, false, [4, 3]);
    circle(ctx, here, 3, colors.place, 1, true);
    if (place.yaw_rad !== null) {
      const [n, e] = place.pos_ned_m, r = place.accept_radius_m;
      arrow(ctx, here, at([n + r * Math.cos(place.yaw_rad), e + r * Math.sin(place.yaw_rad)]), colors.place, 1.2);
    }
    text(ctx, place.name, here[0] + 8, here[1] - 9, colors.place);
  }
  if (!frame) return;
  stroke(ctx, many(trail), colors.trail, 1.5);
  const control = frame.control;
  if (control) {
    stroke(ctx, many(control.route_ned_m), colors.route, 1.5, false, [2, 3]);
    if (control.tube_m.length) {
      drawTube(ctx, many(control.horizon_ned_m), control.tube_m.map((r) => r * scale), colors);
    }
    stroke(ctx, many(control.horizon_ned_m), colors.horizon, 2);
    for (const point of many(control.horizon_ned_m)) circle(ctx, point, 1.6, colors.horizon, 1, true);
  }
  if (frame.goal) circle(ctx, at(frame.goal.pos_ned_m), frame.goal.accept_radius_m * scale, colors.goal, 2);
  if (frame.truth) stroke(ctx, many(hull(frame.truth.pos_ned_m, frame.truth.rpy_rad[2], 0.9 * scene.body_radius_m)), colors.truth, 1.2, true);
  if (frame.estimate) {
    const { pos_ned_m: place, rpy_rad: rpy, sigma_pos_m: sigma, current_ned_m_s: current } = frame.estimate;
    const paint = lost ? faded(colors) : colors;
    const size = Math.max(scene.body_radius_m, LEAST_PX / scale); // seen from far away still a vehicle
    circle(ctx, at(place), scene.body_radius_m * scale, paint.body, 1.2);
    circle(ctx, at(place), 3 * Math.max(sigma[0], sigma[1]) * scale, paint.body, 1, false, [2, 2]);
    const shape = many(hull(place, rpy[2], 0.9 * size));
    fill(ctx, shape, paint.tube);
    fill(ctx, [shape[0], shape[1], shape[4]], paint.nose);
    stroke(ctx, shape, paint.body, 2, true);
    arrow(ctx, at(place), at([place[0] + reach * current[0], place[1] + reach * current[1]]), paint.felt, 2.5);
  }
}

// `view`: of the plan. Zoomed in, the side view shows the part along its axis that the plan shows.
export function drawSide(ctx, width, height, { scene, frame, trail, lost, camera, view }, colors) {
  const all = extent(scene, frame), turned = planView(2, 1, all).turned, box = camera ? view.box : all;
  let [a0, a1, axis] = turned ? [box.n0, box.n1, 0] : [box.e0, box.e1, 1];
  const floor = floorDepth(scene, frame);
  const scale = Math.min(width / (a1 - a0), (height - 16) / (1.12 * floor));
  const middle = 0.5 * (a0 + a1), top = 8 + 0.04 * floor * scale;
  if (camera) [a0, a1] = [middle - width / 2 / scale, middle + width / 2 / scale];
  const at = (p) => [width / 2 + (p[axis] - middle) * scale, top + p[2] * scale];
  const flat = (along, z) => [width / 2 + (along - middle) * scale, top + z * scale];
  clear(ctx, width, height, colors);
  fill(ctx, [flat(a0, 0), flat(a1, 0), flat(a1, floor), flat(a0, floor)], colors.water);
  stroke(ctx, [flat(a0, 0), flat(a1, 0)], colors.flow, 2);
  if (scene.tank_m.length) {
    const along = scene.tank_m.map((p) => p[axis]), left = Math.min(...along), right = Math.max(...along);
    stroke(ctx, [flat(left, 0), flat(left, floor), flat(right, floor), flat(right, 0)], colors.wall, 2.5);
  }
  for (const solid of frame ? frame.solids : []) {
    const along = solid.center_m[axis], r = solid.radius_m;
    if (solid.depth_m !== null) circle(ctx, flat(along, solid.depth_m), r * scale, colors.solid, 1, true);
    else {
      const pillar = [flat(along - r, 0), flat(along + r, 0), flat(along + r, floor), flat(along - r, floor)];
      fill(ctx, pillar, colors.pillar);
      stroke(ctx, pillar, colors.solid, 1, true);
    }
  }
  // The fence as seen from here: where the vehicle's centre may be along this axis, and between which depths.
  for (const shape of scene.fence) {
    const along = shape.corners_m.map((p) => p[axis]), left = Math.min(...along), right = Math.max(...along), r = scene.body_radius_m;
    const free = shape.inclusion ? [[left, left + r], [right - r, right]] : [[left - r, right + r]];
    for (const [from, to] of free) fill(ctx, [flat(from, 0), flat(to, 0), flat(to, floor), flat(from, floor)], colors.margin);
    for (const edge of [left, right]) stroke(ctx, [flat(edge, 0), flat(edge, floor)], colors.fence, 1.2, false, [6, 4]);
  }
  for (const depth of [scene.parameters.DEPTH_MIN, scene.parameters.DEPTH_MAX]) {
    if (depth > 0 && depth <= floor) stroke(ctx, [flat(a0, depth), flat(a1, depth)], colors.fence, 1.2, false, [6, 4]);
  }
  for (const place of scene.places) {
    circle(ctx, at(place.pos_ned_m), place.accept_radius_m * scale, colors.place, 1.2, false, [4, 3]);
    text(ctx, place.name, at(place.pos_ned_m)[0] + 6, at(place.pos_ned_m)[1] - 8, colors.place);
  }
  text(ctx, `${turned ? "north" : "east"} →   depth ↓ ${floor.toFixed(1)} m`, 8, height - 8, colors.weak);
  if (!frame || !frame.estimate) return;
  if (frame.goal) circle(ctx, at(frame.goal.pos_ned_m), frame.goal.accept_radius_m * scale, colors.goal, 2);
  stroke(ctx, trail.map(at), colors.trail, 1.2);
  if (frame.control) {
    const ahead = frame.control.horizon_ned_m.map(at);
    if (frame.control.tube_m.length) drawTube(ctx, ahead, frame.control.tube_m.map((r) => r * scale), colors);
    stroke(ctx, ahead, colors.horizon, 2);
  }
  const { pos_ned_m: place, rpy_rad: rpy } = frame.estimate, r = scene.body_radius_m, h = scene.half_height_m;
  const heading = turned ? Math.cos(rpy[2]) : Math.sin(rpy[2]), forward = heading >= 0 ? 1 : -1;
  const lean = -rpy[1] * forward, half = Math.max(r * Math.abs(heading), 0.5 * r);
  const turn = (x, z) => flat(place[axis] + x * Math.cos(lean) - z * Math.sin(lean), place[2] + x * Math.sin(lean) + z * Math.cos(lean));
  const body = [turn(-half, -h), turn(half, -h), turn(half + 0.3 * half * Math.max(forward, 0), 0), turn(half, h), turn(-half, h), turn(-half + 0.3 * half * Math.min(forward, 0), 0)];
  const bow = forward > 0 ? [body[1], body[2], body[3]] : [body[0], body[5], body[4]];
  const paint = lost ? faded(colors) : colors;
  fill(ctx, bow, paint.nose);
  stroke(ctx, body, paint.body, 2, true);
  if (frame.truth) circle(ctx, at(frame.truth.pos_ned_m), 2.5, colors.truth, 1, true);
}

// `old`: how old it is in words, "" while it is of now. What was found in an old picture is not there any more.
export function drawPicture(ctx, width, height, picture, image, old, colors) {
  clear(ctx, width, height, colors);
  if (!picture) { text(ctx, "no picture", width / 2, height / 2, colors.weak, "center"); return; }
  const found = old ? [DARK.weak, DARK.weak] : ["#27d07d", "#ff4d4d"];
  const scale = Math.min(width / picture.width_px, height / picture.height_px);
  const x = (width - scale * picture.width_px) / 2, y = (height - scale * picture.height_px) / 2;
  ctx.globalAlpha = old ? 0.4 : 1;
  if (image) ctx.drawImage(image, x, y, scale * picture.width_px, scale * picture.height_px);
  ctx.globalAlpha = 1;
  const at = ([px, py]) => [x + scale * px, y + scale * py];
  for (const [id, corners] of picture.markers) {
    const name = String(id), [left, up] = at(corners[0]);
    stroke(ctx, corners.map(at), DARK.back, 3.5, true);
    stroke(ctx, corners.map(at), found[0], 1.5, true);
    ctx.fillStyle = DARK.back;
    ctx.fillRect(left, up - 13, 4 + 7 * name.length, 14);
    text(ctx, name, left + 2, up - 6, found[0]);
  }
  if (picture.laser_px) circle(ctx, at(picture.laser_px), 6, found[1], 2);
  if (!old) return;
  ctx.fillStyle = colors.back;
  ctx.fillRect(width / 2 - 90, height / 2 - 12, 180, 24);
  text(ctx, `no picture for ${old}`, width / 2, height / 2, colors.ink, "center");
}

// The flow that is added, 1 m/s at the rim, outside of which there is room for the word.
const RIM = 0.36;
export function drawFlow(ctx, width, height, flow, turned, colors) {
  const middle = [width / 2, height / 2], reach = RIM * Math.min(width, height);
  clear(ctx, width, height, colors);
  circle(ctx, middle, reach, colors.weak, 1);
  circle(ctx, middle, reach / 2, colors.weak, 1, false, [2, 3]);
  text(ctx, "N", turned ? width - 7 : middle[0], turned ? middle[1] : 7, colors.weak, "center");
  if (!flow) return;
  const [u, v] = flow.map((part) => Math.sign(part) * Math.sqrt(Math.abs(part)));
  const tip = turned ? [middle[0] + reach * u, middle[1] + reach * v] : [middle[0] + reach * v, middle[1] - reach * u];
  arrow(ctx, middle, tip, colors.trail, 3);
  circle(ctx, tip, 5, colors.trail, 1, true);
}

export function flowAt(x, y, width, height, turned) {
  const reach = RIM * Math.min(width, height), part = (value) => Math.max(-1, Math.min(1, value / reach));
  const [u, v] = turned ? [part(x - width / 2), part(y - height / 2)] : [part(height / 2 - y), part(x - width / 2)];
  const square = (value) => Math.round(100 * Math.sign(value) * value * value) / 100;
  return [square(u), square(v)];
}
