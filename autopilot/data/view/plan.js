// Which part of the world the plan shows. Nothing here knows the page or draws.
// A camera is { n, e, scale, follow }: the world point in the middle and pixels per metre; null = everything.

// Strips above and below the plan: for north, the key of the current and the scale.
export const STRIP = 26;
export const ZOOM_STEP = 1.5; // of a key or a button
const MOST_PX_M = 1000; // 1 mm per pixel
const FOLLOW_RADIUS_PX = 12; // of the vehicle, at least, when following begins
const LINE_PX = 56; // least distance of two grid lines
const LEAST_FINE = 4; // arrows along a side of a fine grid that is shown
const ARROW_PX = 20; // least distance of two arrows of the current

// Arrows of the current: a round figure, of the size of the fastest there is, is drawn as long as this share of the
// plan's longer side, and stands beside the plan as the key. Where no water is shown to flow it is that of a tank.
const ARROW_SHARE = 0.07, TANK_M_S = 0.2, STILL_M_S = 0.005;

// The largest of 1, 2 and 5 times a power of ten that is not above a value.
function roundFigure(value) {
  const power = 10 ** Math.floor(Math.log10(value) + 1e-9);
  return power * Math.max(...[1, 2, 5].filter((figure) => figure * power <= value * (1 + 1e-9)));
}

// Distance of grid lines [m], which is also the length of the scale bar: the least of 1, 2, 5 that leaves LINE_PX.
export function gridStep(scale) {
  const below = roundFigure(LINE_PX / scale);
  return below * scale >= LINE_PX * (1 - 1e-9) ? below : roundFigure(2.5 * below * (1 + 1e-9));
}

// The speed that the key tells, and the way (m) that 1 m/s is drawn as.
export function flowScale(flow, box) {
  const fastest = Math.max(0, ...(flow ? [...flow.arrows, ...(flow.near ?? [])] : []).map(([, , u, v]) => Math.hypot(u, v)));
  const told = fastest < STILL_M_S ? TANK_M_S : roundFigure(fastest);
  return { told, reach: (ARROW_SHARE * Math.max(box.n1 - box.n0, box.e1 - box.e0)) / told };
}

// Of a field on a regular grid every k-th row and column, so that arrows stand `least` pixels apart, and no less than
// ARROW_PX; and of these what is in sight.
export function thinned(arrows, view, least = 0) {
  const apart = Math.max(ARROW_PX, least);
  const [rows, columns] = [0, 1].map((axis) => {
    const values = [...new Set(arrows.map((arrow) => arrow[axis]))].sort((a, b) => a - b);
    const step = values.length > 1 ? (values[values.length - 1] - values[0]) / (values.length - 1) : Infinity;
    const every = Math.min(Math.max(1, Math.ceil(apart / (step * view.scale) - 1e-9)), values.length);
    const first = Math.floor(((values.length - 1) % every) / 2);
    return new Set(values.filter((_, index) => index % every === first));
  });
  const { n0, n1, e0, e1 } = view.box;
  return arrows.filter(([n, e]) => rows.has(n) && columns.has(e) && n >= n0 && n <= n1 && e >= e0 && e <= e1);
}

// What "everything" is: tank, fence, waypoints, obstacles, goal, the vehicle; never less than a metre.
export function extent(scene, frame) {
  const points = [...scene.tank_m];
  const round = ([n, e], r) => points.push([n - r, e - r], [n + r, e + r]);
  for (const place of scene.places) round(place.pos_ned_m, place.accept_radius_m);
  for (const shape of scene.fence) points.push(...shape.corners_m);
  if (frame) {
    for (const solid of frame.solids) round(solid.center_m, solid.radius_m);
    if (frame.goal) round(frame.goal.pos_ned_m, frame.goal.accept_radius_m);
    for (const state of [frame.estimate, frame.truth]) if (state) round(state.pos_ned_m, scene.body_radius_m);
  }
  if (!points.length) points.push([0, 0]);
  const norths = points.map((p) => p[0]), easts = points.map((p) => p[1]);
  let [n0, n1, e0, e1] = [Math.min(...norths), Math.max(...norths), Math.min(...easts), Math.max(...easts)];
  const pad = Math.max(0.06 * Math.max(n1 - n0, e1 - e0), 0.5 - 0.5 * Math.max(n1 - n0, e1 - e0), 0.1);
  return { n0: n0 - pad, n1: n1 + pad, e0: e0 - pad, e1: e1 + pad };
}

// Of the two grids of a field the fine one in its place, where that can be seen, the other one elsewhere.
export function flowArrows({ arrows, near = [] }, view, least) {
  if (!near.length) return thinned(arrows, view, least);
  const [norths, easts] = [0, 1].map((axis) => near.map((arrow) => arrow[axis]));
  const [n0, n1, e0, e1] = [Math.min(...norths), Math.max(...norths), Math.min(...easts), Math.max(...easts)];
  if (Math.min(n1 - n0, e1 - e0) * view.scale < LEAST_FINE * Math.max(ARROW_PX, least)) return thinned(arrows, view, least);
  const outside = arrows.filter(([n, e]) => n < n0 || n > n1 || e < e0 || e > e1);
  return [...thinned(outside, view, least), ...thinned(near, view, least)];
}

// Depth of the water [m]; where it is not known, what leaves room below waypoints and vehicle.
export function floorDepth(scene, frame) {
  const depths = [...scene.places.map((p) => p.pos_ned_m[2]), frame && frame.estimate ? frame.estimate.pos_ned_m[2] : 0];
  return scene.tank_depth_m === null ? Math.max(1, 1.3 * Math.max(...depths)) : scene.tank_depth_m;
}

// North is up, or to the right where the water is longer that way than the canvas is high.
export function planView(width, height, all, camera = null) {
  const north = all.n1 - all.n0, east = all.e1 - all.e0;
  const high = Math.max(height - 2 * STRIP, 1);
  const upright = Math.min(width / east, high / north), lying = Math.min(width / north, high / east);
  const turned = lying > 1.2 * upright, fit = turned ? lying : upright;
  const middle = { n: 0.5 * (all.n0 + all.n1), e: 0.5 * (all.e0 + all.e1), scale: fit };
  const { n, e, scale } = camera ?? middle;
  const [dn, de] = (turned ? [width, high] : [high, width]).map((pixels) => pixels / 2 / scale);
  return {
    scale, turned, fit, all, n, e,
    box: { n0: n - dn, n1: n + dn, e0: e - de, e1: e + de },
    at: ([pn, pe]) => (turned ? [width / 2 + (pn - n) * scale, height / 2 + (pe - e) * scale]
      : [width / 2 + (pe - e) * scale, height / 2 - (pn - n) * scale]),
    back: (x, y) => (turned ? [n + (x - width / 2) / scale, e + (y - height / 2) / scale]
      : [n - (y - height / 2) / scale, e + (x - width / 2) / scale]),
  };
}

const within = (value, low, high) => Math.min(Math.max(value, low), high);

// The middle stays within everything, so that the plan cannot be lost.
const held = (camera, { n0, n1, e0, e1 }) => ({ ...camera, n: within(camera.n, n0, n1), e: within(camera.e, e0, e1) });

// The point under (x, y) stays there; a vehicle that is followed stays in the middle. Zoomed out to everything = null.
export function zoomed(view, follow, factor, [x, y]) {
  const scale = Math.min(view.scale * factor, Math.max(MOST_PX_M, view.fit));
  if (scale <= view.fit * (1 + 1e-9)) return follow ? { n: view.n, e: view.e, scale: view.fit, follow } : null;
  const [n, e] = follow ? [view.n, view.e] : view.back(x, y), share = view.scale / scale;
  return held({ n: n + (view.n - n) * share, e: e + (view.e - e) * share, scale, follow }, view.all);
}

// By pixels to the right and down, as what is shown moves. Following ends.
export function panned(view, [dx, dy]) {
  const [n, e] = view.back(0, 0), [n1, e1] = view.back(dx, dy);
  return held({ n: view.n + n - n1, e: view.e + e - e1, scale: view.scale, follow: false }, view.all);
}

export function following(view, [n, e], radius_m) {
  return { n, e, scale: Math.max(view.scale, Math.min(FOLLOW_RADIUS_PX / radius_m, MOST_PX_M)), follow: true };
}

// `calm` (prefers-reduced-motion): the plan stands still until the vehicle leaves the middle half of it.
export function followed(camera, view, [n, e], calm) {
  const { n0, n1, e0, e1 } = view.box;
  const near = Math.abs(n - camera.n) < 0.25 * (n1 - n0) && Math.abs(e - camera.e) < 0.25 * (e1 - e0);
  return calm && near ? camera : { ...camera, n, e };
}
