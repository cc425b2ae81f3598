// How far the vehicle's body is from what it keeps clear of, and the body and tube of its prediction from the fence: the
// places at which that is least. Nothing here knows the page.
import { number, stroke, text } from "./ink.js";

const LEAST_BODY_PX = 8; // radius of the body below which there is no room for dimensions
const TICK_PX = 4, FAR_PX = 70; // of a line's ends, and of its figure from the body at most
const APART_PX = [44, 14]; // of two figures; the second is left out where it would cover the first

// The nearest point of an edge.
function nearestOf([n, e], [n0, e0], [n1, e1]) {
  const [dn, de] = [n1 - n0, e1 - e0], share = ((n - n0) * dn + (e - e0) * de) / (dn * dn + de * de || 1);
  const at = Math.min(Math.max(share, 0), 1);
  return [n0 + at * dn, e0 + at * de];
}

function encloses(corners, [n, e]) {
  let inside = false;
  corners.forEach(([n0, e0], index) => {
    const [n1, e1] = corners[(index + 1) % corners.length];
    if ((e0 > e) !== (e1 > e) && n < n0 + ((e - e0) * (n1 - n0)) / (e1 - e0)) inside = !inside;
  });
  return inside;
}

// { point, gap_m } of the nearest boundary; the gap is negative beyond it. null without a fence.
export function nearestFence(fence, place) {
  let nearest = null;
  for (const { inclusion, corners_m: corners } of fence) {
    let point = null, apart = Infinity;
    corners.forEach((corner, index) => {
      const found = nearestOf(place, corner, corners[(index + 1) % corners.length]);
      const length = Math.hypot(found[0] - place[0], found[1] - place[1]);
      if (length < apart) [point, apart] = [found, length];
    });
    const gap_m = encloses(corners, place) === inclusion ? apart : -apart;
    if (point && (!nearest || gap_m < nearest.gap_m)) nearest = { point, gap_m };
  }
  return nearest;
}

function nearestTrack(tracks, place) {
  let nearest = null;
  for (const { pos_ned_m: middle, radius_m } of tracks) {
    const apart = Math.hypot(middle[0] - place[0], middle[1] - place[1]), gap_m = apart - radius_m, share = apart && gap_m / apart;
    if (!nearest || gap_m < nearest.gap_m) nearest = { point: place.slice(0, 2).map((part, axis) => part + share * (middle[axis] - part)), gap_m };
  }
  return nearest;
}

// Dimensions { place, point, keep_m, free_m, color }: from keep_m round a place it is free_m to the nearest point.
export function dimensions(scene, frame) {
  const { estimate, control, tracks } = frame, made = [], body = scene.body_radius_m;
  if (!estimate) return made;
  const place = estimate.pos_ned_m, fresh = tracks.filter((track) => track.age_s <= scene.ages.track_s);
  const near = [nearestFence(scene.fence, place), nearestTrack(fresh, place)].filter(Boolean).sort((a, b) => a.gap_m - b.gap_m)[0];
  if (near) made.push({ place, point: near.point, keep_m: body, free_m: near.gap_m - body, color: "ink" });
  let least = null;
  for (const [index, tube_m] of (control ? control.tube_m : []).entries()) {
    const ahead = control.horizon_ned_m[index], found = nearestFence(scene.fence, ahead), keep_m = body + tube_m;
    if (found && (!least || found.gap_m - keep_m < least.free_m)) least = { place: ahead, point: found.point, keep_m, free_m: found.gap_m - keep_m, color: "horizon" };
  }
  if (least) made.push(least);
  return made;
}

// Thin dimension lines with their lengths, while the plan is near enough.
export function drawDimensions(ctx, view, scene, frame, colors) {
  if (scene.body_radius_m * view.scale < LEAST_BODY_PX) return;
  const figures = [];
  for (const { place, point, keep_m, free_m, color } of dimensions(scene, frame)) {
    const [from, to] = [view.at(place), view.at(point)], inside = free_m + keep_m < 0 ? -1 : 1;
    const apart = Math.hypot(to[0] - from[0], to[1] - from[1]) || 1, [u, v] = [(inside * (to[0] - from[0])) / apart, (inside * (to[1] - from[1])) / apart];
    const edge = [from[0] + u * keep_m * view.scale, from[1] + v * keep_m * view.scale], paint = colors[free_m < 0 ? "fence" : color];
    const along = Math.min(0.5 * Math.abs(free_m) * view.scale, FAR_PX), side = u > 0.7 || u < -0.7 ? 0 : 1;
    const beside = [edge[0] + u * along + 6 * side, edge[1] + v * along - (side ? 0 : 9)];
    if (figures.some((other) => Math.abs(other[0] - beside[0]) < APART_PX[0] && Math.abs(other[1] - beside[1]) < APART_PX[1])) continue;
    figures.push(beside);
    stroke(ctx, [edge, to], paint, 1);
    for (const [x, y] of [edge, to]) stroke(ctx, [[x - TICK_PX * v, y + TICK_PX * u], [x + TICK_PX * v, y - TICK_PX * u]], paint, 1);
    text(ctx, `${number(free_m, 2)} m`, ...beside, colors[free_m < 0 ? "fence" : "ink"], side ? "left" : "center");
  }
}
