// The page: takes the stream, draws when there is something new, sends what is asked for.
import { DARK, LEGEND, LIGHT, drawFlow, drawPicture, drawPlan, drawSide, flowAt } from "./draw.js";

const $ = (id) => document.getElementById(id);
const token = document.querySelector("meta[name=view-token]").content;
const dark = matchMedia("(prefers-color-scheme: dark)");
const seen = { scene: null, frame: null, flow: null, picture: null, image: null, trail: [], view: null, moving: null };
const TRAIL = 1500;
const OLD_S = 2; // what is older is no news: a sensor is silent, the controller at rest
let source = null, heard = 0, asked = false, messages = 0, drag = null;

const colors = () => (dark.matches ? DARK : LIGHT);
const unsigned = (words) => words.replace(/^-(0(\.0*)?)$/, "$1"); // no minus before nothing
const fixed = (value, digits = 2) => (value === null || value === undefined ? "–" : unsigned(value.toFixed(digits)));
const current = (frame) => (frame.control && frame.control.age_s <= OLD_S ? frame.control : null);
const plain = (name) => name.toLowerCase().replaceAll("_", " ");
const degrees = (radians) => unsigned(((radians * 180) / Math.PI).toFixed(1)) + "°";

function element(tag, words, kind) {
  const made = document.createElement(tag);
  if (words !== undefined) made.textContent = words;
  if (kind) made.className = kind;
  return made;
}

// Canvases in the screen's own pixels.
function context(canvas) {
  const ratio = window.devicePixelRatio || 1, width = canvas.clientWidth, height = canvas.clientHeight;
  if (canvas.width !== Math.round(width * ratio) || canvas.height !== Math.round(height * ratio)) {
    canvas.width = Math.round(width * ratio);
    canvas.height = Math.round(height * ratio);
  }
  const ctx = canvas.getContext("2d");
  ctx.setTransform(ratio, 0, 0, ratio, 0, 0);
  return [ctx, width, height];
}

function draw() {
  asked = false;
  const palette = colors();
  if (seen.scene) {
    const shown = { ...seen, frame: seen.frame && { ...seen.frame, control: current(seen.frame) } };
    seen.view = drawPlan(...context($("plan")), shown, palette);
    drawSide(...context($("side")), shown, palette);
    if (seen.scene.steerable.current) {
      drawFlow(...context($("flow")), drag && drag.flow ? drag.flow : seen.frame && seen.frame.extra_current_ned_m_s, seen.view && seen.view.turned, palette);
    }
  }
  if ($("camerabox").open) drawPicture(...context($("camera")), seen.picture, seen.image, palette);
}

function soon() {
  if (asked) return;
  asked = true;
  requestAnimationFrame(draw);
}

// Panels

function bar(name, value, limit, words, two) {
  const row = element("div", undefined, "bar"), track = element("div", undefined, two ? "track two" : "track"), rod = element("i");
  const share = limit > 0 ? Math.min(Math.abs(value) / limit, 1) : 0;
  if (two) {
    rod.style.left = `${50 - (value < 0 ? 50 * share : 0)}%`;
    rod.style.width = `${50 * share}%`;
  } else {
    rod.style.left = "0";
    rod.style.width = `${100 * share}%`;
  }
  if (Math.abs(value) > 0.995 * limit) rod.className = "full";
  track.append(rod);
  row.append(element("span", name), track, element("span", words));
  return row;
}

function showState(frame) {
  const { estimate: nav, truth, control, progress, battery, loop, goal } = frame, rows = [];
  if (nav) {
    rows.push(["Estimate", nav.health + (nav.doubts.length ? ` (doubt: ${nav.doubts.join(", ")})` : "")]);
    rows.push(["North, east, depth", nav.pos_ned_m.map((v) => fixed(v)).join(", ") + " m"]);
    rows.push(["Roll, pitch, yaw", nav.rpy_rad.map(degrees).join(", ")]);
    const [north, east, down] = nav.sigma_pos_m.map((v) => (1e3 * v).toFixed(1));
    rows.push(["Sigma", `${north}, ${east}, ${down} mm, ${degrees(nav.sigma_yaw_rad)}`]);
    rows.push(["Current felt", `${nav.current_ned_m_s.slice(0, 2).map((v) => fixed(v)).join(", ")} m/s`]);
  } else rows.push(["Estimate", "none yet"]);
  if (truth && nav) {
    const off = Math.hypot(...truth.pos_ned_m.map((v, i) => v - nav.pos_ned_m[i]));
    rows.push(["Off the truth", `${(1e3 * off).toFixed(1)} mm`]);
  }
  if (truth) rows.push(["Contacts", `${truth.contacts}`], ["Power", `${fixed(truth.power_w, 0)} W`]);
  if (progress) rows.push(["Mission", `${progress.state}, item ${progress.item}, lap ${progress.lap + 1}`]);
  if (goal) rows.push(["Goal", `${goal.pos_ned_m.map((v) => fixed(v)).join(", ")} m, ${fixed(goal.speed_m_s)} m/s`]);
  if (control && control.age_s > OLD_S) rows.push(["Controller", `at rest for ${fixed(control.age_s, 0)} s`]);
  else if (control) {
    rows.push(["Controller", `${control.status}${control.fallback === "NONE" ? "" : ", fallback " + control.fallback}`]);
    rows.push(["Margin ahead", `${fixed(control.margin_m, 3)} m beyond body and tube of ${fixed(control.tube_now_m, 3)} m`]);
    if (control.eta_s !== null) rows.push(["To the goal", `${fixed(control.eta_s, 1)} s, ${fixed(control.energy_j, 0)} J`]);
  }
  if (battery) rows.push(["Battery", `${fixed(battery.voltage_v, 1)} V, ${fixed(battery.current_a, 1)} A, ${(100 * battery.remaining).toFixed(0)} %`]);
  if (loop) rows.push(["Loop", `${fixed(loop.longest_tick_ms, 1)} ms longest tick, ${(100 * loop.cpu_share).toFixed(0)} % of a core, ${loop.overruns} overruns`]);
  $("state").replaceChildren(...rows.flatMap(([name, words]) => [element("dt", name), element("dd", words)]));
}

function showBars(scene, frame) {
  const { limits, body_radius_m: radius } = scene, { estimate: nav, control } = frame, rows = [];
  if (nav) {
    const [u, v, w] = nav.vel_water_frd_m_s, planar = Math.hypot(u, v);
    rows.push(bar("Planar speed", planar, limits.planar_speed_m_s, `${fixed(planar)} / ${limits.planar_speed_m_s} m/s`));
    rows.push(bar("Heave", w, limits.heave_m_s, `${fixed(w)} / ${limits.heave_m_s} m/s`, true));
    rows.push(bar("Yaw rate", nav.rate_frd_rad_s[2], limits.yaw_rate_rad_s, `${fixed(nav.rate_frd_rad_s[2])} / ${limits.yaw_rate_rad_s} rad/s`, true));
  }
  if (current(frame)) rows.push(bar("Solve time", control.solve_ms, limits.solve_ms, `${fixed(control.solve_ms, 1)} / ${limits.solve_ms} ms`));
  if (frame.clearance_m !== null) {
    const room = frame.clearance_m - radius;
    const row = bar("To the fence", Math.max(0, 1 - room), 1, `${fixed(room)} m`);
    row.title = "Body to the fence; full = touching";
    rows.push(row);
  }
  $("bars").replaceChildren(...rows);
  $("thrusters").replaceChildren(...scene.thrusters.map((name, index) => {
    const thrust = frame.thrust_n[index] ?? 0, weak = frame.effectiveness[index] ?? 1;
    const acting = frame.truth ? ` (${fixed(frame.truth.thrust_n[index], 1)})` : "";
    const row = bar(name + (weak < 0.95 ? ` ${(100 * weak).toFixed(0)} %` : ""), thrust, limits.thrust_n, `${fixed(thrust, 1)}${acting} N`, true);
    row.title = `${name}: ${frame.pwm_us[index]} us; bound ${limits.thrust_n} N; in brackets: acting`;
    return row;
  }));
}

function showSensors(frame) {
  const head = element("tr");
  head.append(...["sensor", "state", "ratio", "age"].map((words) => element("th", words)));
  $("sensors").replaceChildren(head, ...frame.sensors.map((sensor) => {
    const row = element("tr");
    const state = sensor.age_s > OLD_S ? "SILENT" : sensor.state;
    const kind = state === "ACTIVE" ? "good" : state === "REJECTING" ? "bad" : "warn";
    row.append(element("td", sensor.name), element("td", plain(state), kind), element("td", fixed(sensor.test_ratio)), element("td", `${fixed(sensor.age_s, 1)} s`));
    return row;
  }));
}

function showMessages(frame) {
  const list = $("messages");
  for (const message of frame.messages.filter((one) => one.number > messages && one.severity !== "DEBUG")) {
    const kind = ["EMERGENCY", "ALERT", "CRITICAL", "ERROR"].includes(message.severity) ? "bad" : message.severity === "WARNING" ? "warn" : "";
    const row = element("li", undefined, kind);
    row.append(element("time", `${message.t_s.toFixed(1)} s`), message.text);
    list.prepend(row);
  }
  while (list.children.length > 60) list.lastChild.remove();
  messages = Math.max(messages, ...frame.messages.map((one) => one.number));
}

function showFrame(frame) {
  const { scene } = seen;
  $("mode").textContent = frame.mode;
  $("armed").textContent = frame.armed ? "armed" : "disarmed";
  $("armed").className = frame.armed ? "badge on" : "badge";
  const health = frame.estimate ? frame.estimate.health : "INVALID";
  $("health").textContent = `estimate ${plain(health)}`;
  $("health").className = `badge ${{ GOOD: "good", DEAD_RECKONING: "warn" }[health] ?? "bad"}`;
  const steered = current(frame), lost = steered && steered.fallback !== "NONE";
  $("control").textContent = lost ? `control: ${plain(steered.fallback)}` : "";
  $("control").className = "badge warn";
  $("clock").textContent = `${frame.t_s.toFixed(1)} s${frame.paused ? ", paused" : ""}`;
  $("link").textContent = frame.stale_s > 2 && !frame.paused ? `the loop has been silent for ${frame.stale_s.toFixed(0)} s` : "";
  $("alarms").textContent = frame.failsafes.length ? `Failsafe: ${frame.failsafes.map(plain).join(", ")}` : "";
  showState(frame);
  showBars(scene, frame);
  showSensors(frame);
  showMessages(frame);
  $("pause").textContent = frame.paused ? "Go on" : "Pause";
  const speed = $("speed");
  if (document.activeElement !== speed && frame.speed > 0) speed.value = String(frame.speed);
  const flow = frame.extra_current_ned_m_s;
  $("flowtext").textContent = flow ? `added flow: ${fixed(flow[0])} m/s north, ${fixed(flow[1])} m/s east` : "";
}

function showScene(scene) {
  document.title = `${scene.title || scene.vehicle}: live view`;
  $("title").textContent = `${scene.title} · ${scene.vehicle}${scene.simulated ? " · simulated" : ""}`;
  const can = scene.steerable;
  $("steer").hidden = !can.pause;
  $("readonly").textContent = can.pause ? "" : can.missing.join(" ");
  $("speed").parentElement.hidden = !can.speed;
  const speeds = [0.25, 0.5, 1, 2, 4, 8];
  if (!$("speed").children.length) $("speed").replaceChildren(...speeds.map((value) => Object.assign(element("option", `${value} ×`), { value: String(value) })));
  $("fault").replaceChildren(...can.faults.map((offer, index) => Object.assign(element("option", offer.label), { value: String(index) })));
  $("fault").parentElement.parentElement.hidden = !can.faults.length;
  $("flow").parentElement.hidden = !can.current;
  $("hint").textContent = [can.obstacles ? "Drag an obstacle on the plan; the fence stays where it is." : "", ...can.missing].join(" ").trim();
  $("camerabox").hidden = scene.camera_px === null;
}

// The stream

function listen() {
  const wanted = $("camerabox").open ? "/events?pictures=1" : "/events";
  if (source && source.url.endsWith(wanted)) return;
  if (source) source.close();
  source = new EventSource(wanted);
  const on = (name, work) => source.addEventListener(name, (event) => { heard = Date.now(); work(JSON.parse(event.data)); soon(); });
  on("scene", (scene) => { seen.scene = scene; seen.trail = scene.trail_ned_m; messages = 0; $("messages").replaceChildren(); showScene(scene); });
  on("frame", (frame) => {
    if (!seen.scene) return;
    if (seen.frame && frame.t_s < seen.frame.t_s) seen.trail = [];
    seen.frame = frame;
    const nav = frame.estimate, last = seen.trail[seen.trail.length - 1];
    if (nav && (!last || Math.hypot(last[0] - nav.pos_ned_m[0], last[1] - nav.pos_ned_m[1], last[2] - nav.pos_ned_m[2]) > 0.01)) {
      seen.trail = [...seen.trail.slice(1 - TRAIL), nav.pos_ned_m];
    }
    showFrame(frame);
  });
  on("flow", (flow) => { seen.flow = flow; });
  on("trouble", (trouble) => { $("link").textContent = trouble.text; });
  on("picture", (picture) => {
    const image = new Image();
    image.onload = () => { seen.picture = picture; seen.image = image; soon(); };
    image.src = `data:image/jpeg;base64,${picture.jpeg}`;
  });
  source.onerror = () => { $("link").textContent = "no connection to the vehicle's process"; };
}

async function ask(table) {
  const said = $("said");
  try {
    const answer = await fetch("/do", { method: "POST", headers: { "Content-Type": "application/json", "X-View-Token": token }, body: JSON.stringify(table) });
    const words = await answer.json();
    said.textContent = words.done || words.error;
    said.className = answer.ok ? "" : "bad";
  } catch {
    said.textContent = "the process does not answer";
    said.className = "bad";
  }
}

// What the person does

$("pause").addEventListener("click", () => ask({ do: seen.frame && seen.frame.paused ? "go" : "pause" }));
$("speed").addEventListener("change", (event) => { ask({ do: "speed", value: Number(event.target.value) }); event.target.blur(); });
$("reset").addEventListener("click", () => ask({ do: "reset" }));
$("call").addEventListener("click", () => ask({ do: "fault", fault: seen.scene.steerable.faults[Number($("fault").value)].fault }));
$("still").addEventListener("click", () => ask({ do: "current", north_m_s: 0, east_m_s: 0 }));
$("camerabox").addEventListener("toggle", listen);

function spot(event) {
  const box = event.target.getBoundingClientRect();
  return [event.clientX - box.left, event.clientY - box.top, box.width, box.height];
}

// The obstacle under a pointer or a finger.
function grasped(event) {
  const [x, y] = spot(event);
  if (!seen.view || !seen.frame || !seen.scene.steerable.obstacles) return undefined;
  const [north, east] = seen.view.back(x, y);
  return seen.frame.solids.find((solid) => Math.hypot(solid.center_m[0] - north, solid.center_m[1] - east) <= solid.radius_m + 8 / seen.view.scale);
}

// A finger scrolls the page, also from the plan, which fills a phone; on an obstacle it drags.
$("plan").addEventListener("touchstart", (event) => {
  const finger = event.touches[0];
  if (grasped({ target: event.target, clientX: finger.clientX, clientY: finger.clientY })) event.preventDefault();
}, { passive: false });
$("plan").addEventListener("pointerdown", (event) => {
  const hit = grasped(event);
  if (hit) { seen.moving = { place: hit.center_m, radius_m: hit.radius_m }; drag = { number: hit.number }; event.target.setPointerCapture(event.pointerId); }
});
$("plan").addEventListener("pointermove", (event) => {
  if (!seen.moving) return;
  const [x, y] = spot(event);
  seen.moving = { ...seen.moving, place: seen.view.back(x, y) };
  soon();
});
$("plan").addEventListener("pointerup", (event) => {
  if (!drag || !drag.number) return;
  seen.moving = null;
  const [x, y] = spot(event), [north_m, east_m] = seen.view.back(x, y), number = drag.number;
  drag = null;
  ask({ do: "obstacle", number, north_m, east_m });
});
const pull = (event) => { drag = { flow: flowAt(...spot(event), seen.view && seen.view.turned) }; soon(); };
$("flow").addEventListener("pointerdown", (event) => { event.target.setPointerCapture(event.pointerId); pull(event); });
$("flow").addEventListener("pointermove", (event) => { if (drag && drag.flow) pull(event); });
$("flow").addEventListener("pointerup", () => {
  if (!drag || !drag.flow) return;
  const [north_m_s, east_m_s] = drag.flow;
  drag = null;
  ask({ do: "current", north_m_s, east_m_s });
});
for (const name of ["plan", "flow"]) $(name).addEventListener("pointercancel", () => { drag = seen.moving = null; soon(); });
window.addEventListener("resize", soon);
dark.addEventListener("change", () => { legend(); soon(); });
setInterval(() => { if (heard && Date.now() - heard > 4000) $("link").textContent = "no news from the vehicle's process"; }, 1000);

function legend() {
  $("legend").replaceChildren(...LEGEND.map(([words, name, kind]) => {
    const item = element("li"), mark = element("i", undefined, kind);
    mark.style.color = colors()[name];
    item.append(mark, words);
    return item;
  }));
}

// What there is room for: a picture on a desk, the plan first on a phone.
if (matchMedia("(min-width: 801px)").matches) $("camerabox").open = true;
else $("steer").open = false;
legend();
listen();
