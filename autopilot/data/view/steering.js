// What a person does to the plan and to the simulation, by pointer, finger and key.
import { flowAt } from "./draw.js";
import { ARROWS, apart, plainKey, viewKeys, wheelZoom } from "./gestures.js";
import { $, element, fixed, look, meta, present, seen, soon } from "./page.js";
import { ZOOM_STEP, following, gridStep, panned, planView, zoomed } from "./plan.js";
import { SpaceView } from "./space.js";
import { ask, say } from "./stream.js";

$("pause").addEventListener("click", () => ask({ do: present.frame && present.frame.paused ? "go" : "pause" }));
$("speed").addEventListener("change", (event) => { ask({ do: "speed", value: Number(event.target.value) }); event.target.blur(); });
$("reset").addEventListener("click", () => ask({ do: "reset" }));
$("call").addEventListener("click", () => seen.scene && ask({ do: "fault", fault: seen.scene.steerable.faults[Number($("fault").value)].fault }));
$("still").addEventListener("click", () => ask({ do: "current", north_m_s: 0, east_m_s: 0 }));

function spot(event) {
  const box = event.target.getBoundingClientRect();
  return [event.clientX - box.left, event.clientY - box.top, box.width, box.height];
}

// The obstacle under a pointer or a finger.
function grasped(event) {
  const [x, y] = spot(event);
  if (seen.past || !seen.view || !seen.frame || !seen.scene.steerable.obstacles) return undefined;
  const [north, east] = seen.view.back(x, y);
  return seen.frame.solids.find((solid) => Math.hypot(solid.center_m[0] - north, solid.center_m[1] - east) <= solid.radius_m + 8 / seen.view.scale);
}

function zoom(factor, place) {
  const { view, camera } = seen, canvas = $("plan");
  if (space.on) space.zoom(factor);
  else if (view) look(zoomed(view, Boolean(camera && camera.follow), factor, place ?? [canvas.clientWidth / 2, canvas.clientHeight / 2]));
}

function pan(way) { if (seen.view) look(panned(seen.view, way)); }

function fit() {
  look(null);
  space.fit();
}

function follow() {
  const { view, camera, frame, scene } = seen;
  if (camera && camera.follow) look({ ...camera, follow: false });
  else if (view && frame && frame.estimate) look(following(view, frame.estimate.pos_ned_m, scene.body_radius_m));
}

$("nearer").addEventListener("click", () => zoom(ZOOM_STEP));
$("farther").addEventListener("click", () => zoom(1 / ZOOM_STEP));
$("fit").addEventListener("click", fit);
$("follow").addEventListener("click", follow);
export const space = new SpaceView({ canvas: $("space"), button: $("solid"), chart: $("chart"), words: $("spacesaid") }, meta("nothree"), { redraw: soon, fit, follow });

const PAN_PX = 60;
const KEYS = viewKeys(zoom, ZOOM_STEP, fit, follow);

function onPlanKey(event) {
  if (!plainKey(event)) return;
  const way = ARROWS[event.key], work = way ? () => pan(way.map((part) => -PAN_PX * part)) : KEYS[event.key];
  if (!work) return;
  event.preventDefault();
  work();
}
$("plan").addEventListener("keydown", onPlanKey);

// A handle for each obstacle that can be moved, for the keyboard; the pointer drags on the plan itself.
export function showHandles(width, height) {
  const solids = !seen.past && seen.frame && seen.scene.steerable.obstacles ? seen.frame.solids : [], box = $("handles");
  if (box.children.length !== solids.length) box.replaceChildren(...solids.map((_, index) => handle(index)));
  solids.forEach((solid, index) => {
    const one = box.children[index], held = seen.moving && seen.moving.number === solid.number;
    const [x, y] = seen.view.at(held ? seen.moving.place : solid.center_m);
    one.style.left = `${Math.min(Math.max(x, 0), width)}px`;
    one.style.top = `${Math.min(Math.max(y, 0), height)}px`;
    const name = `Obstacle ${solid.number} at ${fixed(solid.center_m[0])} m north, ${fixed(solid.center_m[1])} m east: arrow keys, then Enter`;
    if (one.ariaLabel !== name) one.ariaLabel = name;
  });
}

function handle(index) {
  const one = element("button"), solid = () => seen.frame.solids[index];
  one.type = "button";
  one.addEventListener("focus", () => {
    const { view, camera } = seen, [n, e] = solid().center_m, { n0, n1, e0, e1 } = view.box;
    if (n < n0 || n > n1 || e < e0 || e > e1) look({ ...camera, n, e, follow: false });
  });
  one.addEventListener("blur", () => { if (!seen.drag) { seen.moving = null; soon(); } });
  one.addEventListener("keydown", (event) => onHandleKey(event, solid()));
  return one;
}

// Arrow keys carry an obstacle by tenths of the grid, Enter puts it down, Escape leaves it where it was.
function onHandleKey(event, { number, center_m, radius_m }) {
  const way = ARROWS[event.key], { view } = seen;
  if (way && plainKey(event)) {
    event.preventDefault();
    const [x, y] = view.at(seen.moving ? seen.moving.place : center_m), step = 0.1 * gridStep(view.scale) * view.scale;
    const place = view.back(x + step * way[0], y + step * way[1]);
    seen.moving = { number, place, radius_m };
    say(`Obstacle ${number} to ${fixed(place[0])} m north, ${fixed(place[1])} m east: Enter moves it, Escape does not`);
  } else if (event.key === "Enter" && seen.moving) {
    event.preventDefault();
    const [north_m, east_m] = seen.moving.place;
    seen.moving = null;
    ask({ do: "obstacle", number, north_m, east_m });
  } else if (event.key === "Escape" && seen.moving) {
    seen.moving = null;
    say("");
  } else onPlanKey(event);
  soon();
}

// On the plan a pointer drags an obstacle or the plan, two zoom. A finger scrolls the page, also from the plan, which
// fills a phone: it drags an obstacle, and the plan once that is zoomed in.
const pointers = new Map();
$("plan").addEventListener("touchstart", (event) => {
  const finger = event.touches[0];
  if (event.touches.length > 1 || seen.camera || grasped({ target: event.target, clientX: finger.clientX, clientY: finger.clientY })) event.preventDefault();
}, { passive: false });
$("plan").addEventListener("wheel", (event) => {
  if (event.deltaY > 0 && !seen.camera) return; // nothing to zoom out of: the page scrolls
  event.preventDefault();
  zoom(wheelZoom(event), spot(event));
}, { passive: false });
$("plan").addEventListener("pointerdown", (event) => {
  if (event.button > 0) return;
  const hit = pointers.size ? undefined : grasped(event);
  pointers.set(event.pointerId, spot(event));
  if (hit) {
    seen.moving = { number: hit.number, place: hit.center_m, radius_m: hit.radius_m };
    seen.drag = { number: hit.number };
  } else {
    if (seen.drag) seen.moving = null;
    seen.drag = { plan: true };
  }
  event.target.setPointerCapture(event.pointerId);
});
$("plan").addEventListener("pointermove", (event) => {
  if (!seen.drag || !pointers.has(event.pointerId)) return;
  const before = pointers.get(event.pointerId), now = spot(event);
  pointers.set(event.pointerId, now);
  if (seen.drag.number) {
    seen.moving = { ...seen.moving, place: seen.view.back(now[0], now[1]) };
    soon();
    return;
  }
  const other = [...pointers].find(([id]) => id !== event.pointerId);
  if (other) pinch(other[1], before, now);
  else if (event.pointerType !== "touch" || seen.camera) pan([now[0] - before[0], now[1] - before[1]]);
});

// One of two fingers moves: the plan is zoomed as their distance, and goes with the point between them.
function pinch(other, before, now) {
  const [x, y] = other, [x0, y0] = before, [x1, y1] = now;
  zoom(apart(now, other) / apart(before, other), [(x + x0) / 2, (y + y0) / 2]);
  if (!seen.camera || seen.camera.follow) return;
  const canvas = $("plan");
  look(panned(planView(canvas.clientWidth, canvas.clientHeight, seen.view.all, seen.camera), [(x1 - x0) / 2, (y1 - y0) / 2]));
}

$("plan").addEventListener("pointerup", (event) => {
  pointers.delete(event.pointerId);
  const number = seen.drag && seen.drag.number;
  if (!pointers.size) seen.drag = null;
  if (!number) return;
  seen.moving = seen.drag = null;
  const [x, y] = spot(event), [north_m, east_m] = seen.view.back(x, y);
  ask({ do: "obstacle", number, north_m, east_m });
});
const pull = (event) => { seen.drag = { flow: flowAt(...spot(event), seen.view && seen.view.turned) }; soon(); };
$("flow").addEventListener("pointerdown", (event) => { event.target.setPointerCapture(event.pointerId); pull(event); });
$("flow").addEventListener("pointermove", (event) => { if (seen.drag && seen.drag.flow) pull(event); });
$("flow").addEventListener("pointerup", () => {
  if (!seen.drag || !seen.drag.flow) return;
  const [north_m_s, east_m_s] = seen.drag.flow;
  seen.drag = null;
  ask({ do: "current", north_m_s, east_m_s });
});
for (const name of ["plan", "flow"]) $(name).addEventListener("pointercancel", () => { pointers.clear(); seen.drag = seen.moving = null; soon(); });

// Arrow keys turn and lengthen the arrow of the added flow, as the plan lies; Enter adds it, Escape does not.
const FLOW_STEP_M_S = 0.05;
$("flow").addEventListener("keydown", (event) => {
  const way = ARROWS[event.key], flow = (seen.drag && seen.drag.flow) || (seen.frame && seen.frame.extra_current_ned_m_s);
  if (!flow || !plainKey(event)) return;
  if (way) {
    const [dn, de] = seen.view && seen.view.turned ? way : [-way[1], way[0]];
    const part = (value, step) => Math.max(-1, Math.min(1, Math.round(100 * (value + FLOW_STEP_M_S * step)) / 100));
    seen.drag = { flow: [part(flow[0], dn), part(flow[1], de)] };
    say(`Flow ${fixed(seen.drag.flow[0])} m/s north, ${fixed(seen.drag.flow[1])} m/s east: Enter adds it, Escape does not`);
  } else if (event.key === "Enter" && seen.drag && seen.drag.flow) {
    const [north_m_s, east_m_s] = seen.drag.flow;
    seen.drag = null;
    ask({ do: "current", north_m_s, east_m_s });
  } else if (event.key === "Escape" && seen.drag && seen.drag.flow) {
    seen.drag = null;
    say("");
  } else return;
  event.preventDefault();
  soon();
});
$("flow").addEventListener("blur", () => { if (seen.drag && seen.drag.flow) { seen.drag = null; soon(); } });
