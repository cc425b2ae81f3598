// The page: takes the stream, draws when there is something new, sends what is asked for.
import { ASLEEP_S, Link, Pace, REOPEN_S, ageText, pictureAge } from "./ages.js";
import { attitudeOf, attitudeWords, drawCompass, drawHorizon } from "./attitude.js";
import { DARK, LEGEND, LIGHT, drawFlow, drawPicture, drawPlan, drawSide, flowAt } from "./draw.js";
import { History } from "./history.js";
import { ZOOM_STEP, extent, followed, following, gridStep, panned, planView, zoomed } from "./plan.js";
import { Player, timeOfAddress } from "./player.js";
import { SpaceView } from "./space.js";
import { Timeline } from "./timeline.js";

const $ = (id) => document.getElementById(id);
const meta = (name) => document.querySelector(`meta[name=view-${name}]`).content;
const version = meta("version");
const dark = matchMedia("(prefers-color-scheme: dark)"), calm = matchMedia("(prefers-reduced-motion: reduce)");
// `seen` is what is shown: the present, or a moment of the past or of a log.
const seen = { scene: null, frame: null, flow: null, picture: null, image: null, trail: [], view: null, camera: null, moving: null, pictureOld: false, other: false, wall_s: 0, margins: true };
const present = { scene: null, frame: null, flow: null, picture: null, image: null, trail: [] };
const TRAIL = 1500;
const log = meta("source") === "log", history = new History();
let past = log; // whether what is shown is not the present
const PAST_PICTURE_S = 1; // between two pictures that are kept
const link = new Link();
let pace = new Pace();
let token = meta("token"), source = null, opened = 0, heard = 0, trouble = "", asked = false, messages = 0, drag = null;

const colors = () => (dark.matches ? DARK : LIGHT);
const unsigned = (words) => words.replace(/^-(0(\.0*)?)$/, "$1"); // no minus before nothing
const fixed = (value, digits = 2) => (value === null || value === undefined ? "–" : unsigned(value.toFixed(digits)));
const seconds = () => performance.now() / 1e3;
const ages = () => seen.scene.ages;
const current = (frame) => (frame.control && frame.control.age_s <= ages().control_s ? frame.control : null);
const lost = (frame) => !frame.estimate || frame.estimate.health === "INVALID" || frame.estimate.age_s > ages().estimate_s;
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
    const { frame, flow } = seen, now = seconds();
    const shown = { ...seen, frame: frame && { ...frame, control: current(frame) }, lost: frame && lost(frame) };
    const water = !past && flow && frame && pictureAge(flow, frame, now);
    shown.flowOld = water && water.old(ages().flow_s) ? ageText(water.age) : "";
    const [ctx, width, height] = context($("plan"));
    const view = () => planView(width, height, extent(seen.scene, frame), seen.camera);
    if (seen.camera && seen.camera.follow && frame && frame.estimate) {
      shown.camera = seen.camera = followed(seen.camera, view(), frame.estimate.pos_ned_m, calm.matches);
    }
    seen.view = space.on ? view() : drawPlan(ctx, width, height, shown, palette); // in 3-D the plan is hidden
    showHandles(width, height);
    drawSide(...context($("side")), { ...shown, view: seen.view }, palette);
    space.draw({ ...shown, view: seen.view }, palette);
    if (frame && $("attitude").open) showAttitude(shown.frame, palette);
    if (seen.scene.steerable.current) {
      drawFlow(...context($("flow")), drag && drag.flow ? drag.flow : seen.frame && seen.frame.extra_current_ned_m_s, seen.view && seen.view.turned, palette);
    }
    timeline.draw(...context($("strips")), seen, palette);
  }
  if ($("camerabox").open) drawPicture(...context($("camera")), seen.picture, seen.image, pictureOld(seconds()), palette);
}

const DIALS = { horizon: [drawHorizon, "Artificial horizon, roll positive with the right side down, pitch with the nose up"], compass: [drawCompass, "Compass, north up"] };
function showAttitude(frame, palette) {
  const facts = attitudeOf(frame), words = attitudeWords(facts);
  for (const [id, [drawn, name]] of Object.entries(DIALS)) {
    drawn(...context($(id)), facts, palette);
    const told = `${name}: ${words[id].map(([line]) => line).join("; ")}`;
    if ($(id).ariaLabel === told) continue;
    $(id).ariaLabel = told;
    $(`${id}key`).replaceChildren(...keyed(words[id]));
  }
}

// How old the picture is that is shown, in words; "" while it is of now.
function pictureOld(now) {
  const { picture, frame } = seen;
  if (!picture || !frame) return "";
  if (past) return frame.t_s - picture.t_s > ages().picture_s + PAST_PICTURE_S ? ageText(frame.t_s - picture.t_s) : "";
  if (link.age(now) === null) return "";
  const { age, old } = pictureAge(picture, frame, now), behind = link.age(now);
  return seen.other || behind > ages().link_s || old(ages().picture_s) ? ageText(age + behind) : "";
}

// An age beside what it belongs to, which is grey when it is old.
function mark(id, words, old, ...parts) {
  $(id).textContent = words;
  $(id).className = old ? "age old" : "age";
  for (const part of parts) $(part).classList.toggle("stale", Boolean(old));
}

// Everything that is shown, as old as it is now.
function showAges() {
  const { scene, frame, picture } = seen, now = seconds(), late = link.age(now), behind = past ? 0 : late;
  if (!scene || !frame || behind === null) return;
  const limits = scene.ages, cut = !log && (seen.other || late > limits.link_s), dead = cut && !past, nav = frame.estimate;
  const told = (age, old) => (old ? `${ageText(age)} old` : ageText(age)), frames = past ? "" : told(behind, dead);
  const place = !nav ? "no estimate" : nav.health === "INVALID" && !dead ? "estimate invalid" : told(nav.age_s + behind, dead || lost(frame));
  const noPlace = dead || lost(frame), old = pictureOld(now);
  mark("frameage", frames, dead, "now", "alarms", "plan", "side", "legend", "flow", "state", "space", "pwm", "pace");
  for (const id of ["planage", "sideage", "stateage"]) mark(id, place, noPlace);
  const turned = Boolean(frame.measured && frame.measured.rpy_rad);
  mark("attitudeage", turned ? told(behind, dead) : place, turned ? dead : noPlace, "dials");
  mark("barsage", place, noPlace, "bars");
  for (const id of ["thrusters", "sensors", "messages"]) mark(`${id}age`, frames, dead, id);
  mark("cameraage", picture ? told(pictureAge(picture, frame, now).age + behind, old) : "", old, "camera");
  const silence = link.since(now);
  put("link", !cut ? trouble
    : source && source.readyState !== 1 ? `no connection to the vehicle's process; all this is ${ageText(late)} old`
    : silence > limits.link_s ? `no news from the vehicle's process for ${ageText(silence)}`
    : link.loop > limits.link_s ? `the loop has been silent for ${ageText(link.loop)}`
    : `the connection is slow: all this is ${ageText(late)} old`);
  if (old || seen.pictureOld) soon();
  seen.pictureOld = Boolean(old);
}

function soon() {
  if (asked) return;
  asked = true;
  requestAnimationFrame(draw);
}

// What stands in an element, where a reader of the screen hears every change.
function put(id, words) {
  if ($(id).textContent !== words) $(id).textContent = words;
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

// A value that has an age of its own: beyond its limit it is grey, and says how old it is.
const aged = (name, words, age, limit) => (age > limit ? [name, `${words} (${ageText(age)} old)`, "stale"] : [name, words]);

function showState(frame) {
  const { estimate: nav, measured, truth, control, progress, battery, loop, goal } = frame, rows = [];
  const kind = nav && lost(frame) ? "stale" : "";
  if (nav) {
    rows.push(["Estimate", nav.health + (nav.doubts.length ? ` (doubt: ${nav.doubts.join(", ")})` : "")]);
    rows.push(["North, east, depth", nav.pos_ned_m.map((v) => fixed(v)).join(", ") + " m", kind]);
    rows.push(["Roll, pitch, yaw", nav.rpy_rad.map(degrees).join(", "), kind]);
    const [north, east, down] = nav.sigma_pos_m.map((v) => (1e3 * v).toFixed(1));
    rows.push(["Sigma", `${north}, ${east}, ${down} mm, ${degrees(nav.sigma_yaw_rad)}`, kind]);
    const asked = goal ? (goal.speed_asked ? `, ${fixed(goal.speed_m_s)} asked` : `, at most ${fixed(goal.speed_m_s)}`) : "";
    rows.push(["Speed over ground", `${fixed(Math.hypot(...nav.vel_frd_m_s))} m/s${asked}`, kind]);
    rows.push(["Estimated current", `${nav.current_ned_m_s.slice(0, 2).map((v) => fixed(v)).join(", ")} m/s`, kind]);
  } else rows.push(["Estimate", "none"]);
  if (measured && measured.depth_m !== null) rows.push(["Depth by pressure", `${fixed(measured.depth_m)} m`]);
  if (measured && measured.rpy_rad) rows.push(["Roll, pitch, yaw by AHRS", measured.rpy_rad.map(degrees).join(", ")]);
  if (truth && nav) {
    const off = Math.hypot(...truth.pos_ned_m.map((v, i) => v - nav.pos_ned_m[i]));
    rows.push(["Position error", `${(1e3 * off).toFixed(1)} mm`]);
  }
  if (truth) rows.push(["Contacts", `${truth.contacts}`], ["Power", `${fixed(truth.power_w, 0)} W`]);
  if (progress) rows.push(["Mission", `${progress.state}, item ${progress.item}, lap ${progress.lap + 1}`]);
  if (goal) rows.push(["Goal", `${goal.pos_ned_m.map((v) => fixed(v)).join(", ")} m`]);
  if (control && !current(frame)) rows.push(["Controller", `at rest for ${fixed(control.age_s, 0)} s`]);
  else if (control) {
    rows.push(["Controller", `${control.status}${control.fallback === "NONE" ? "" : ", fallback " + control.fallback}`]);
    rows.push(["Predicted margin", `${fixed(control.margin_m, 3)} m beyond body and tube of ${fixed(control.tube_now_m, 3)} m`]);
    if (control.eta_s !== null) rows.push(["Goal in", `${fixed(control.eta_s, 1)} s, ${fixed(control.energy_j, 0)} J, as planned ${ageText(control.plan_age_s)} ago`]);
  }
  if (battery) rows.push(aged("Battery", `${fixed(battery.voltage_v, 1)} V, ${fixed(battery.current_a, 1)} A, ${(100 * battery.remaining).toFixed(0)} %`, battery.age_s, ages().battery_s));
  if (loop) rows.push(aged("Loop", `${fixed(loop.longest_tick_ms, 1)} ms longest tick, ${(100 * loop.cpu_share).toFixed(0)} % of a core, ${loop.overruns} overruns`, loop.age_s, ages().loop_s));
  $("state").replaceChildren(...rows.flatMap(([name, words, kind]) => [element("dt", name), element("dd", words, kind)]));
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
    rows.push(bar("Body to fence", Math.max(0, 1 - room), 1, `${fixed(room)} m`)); // full = touching
  }
  $("bars").replaceChildren(...rows);
  $("thrusters").replaceChildren(...scene.thrusters.map((name, index) => {
    const thrust = frame.thrust_n[index] ?? 0, weak = frame.effectiveness[index] ?? 1;
    const acting = frame.truth ? ` (${fixed(frame.truth.thrust_n[index], 1)})` : "";
    return bar(name + (weak < 0.95 ? ` ${(100 * weak).toFixed(0)} %` : ""), thrust, limits.thrust_n, `${fixed(thrust, 1)}${acting} N`, true);
  }));
  $("pwm").textContent = `PWM ${frame.pwm_us.join(", ")} µs; bound ${limits.thrust_n} N${frame.truth ? "; in brackets: acting" : ""}`;
}

function showSensors(frame) {
  const head = element("tr");
  head.append(...["sensor", "state", "test ratio", "age"].map((words) => element("th", words)));
  const line = (name, words, kind, ratio, age) => {
    const row = element("tr");
    row.append(element("td", name), element("td", words, kind), element("td", ratio), element("td", ageText(age), words === "silent" ? "warn" : ""));
    return row;
  };
  const devices = frame.devices.map(({ name, age_s: age, limit_s: limit }) => line(`${name} device`, age > limit ? "silent" : "delivers", age > limit ? "warn" : "good", "", age));
  $("sensors").replaceChildren(head, ...devices, ...frame.sensors.map((sensor) => {
    const state = sensor.age_s > sensor.limit_s ? "SILENT" : sensor.state;
    return line(sensor.name, plain(state), state === "ACTIVE" ? "good" : state === "REJECTING" ? "bad" : "warn", fixed(sensor.test_ratio), sensor.age_s);
  }));
}

function showMessages(frame) {
  const list = $("messages");
  const newest = Math.max(0, ...frame.messages.map((one) => one.number));
  if (newest < messages) { list.replaceChildren(); messages = 0; } // back in time
  for (const message of frame.messages.filter((one) => one.number > messages && one.severity !== "DEBUG")) {
    const kind = ["EMERGENCY", "ALERT", "CRITICAL", "ERROR"].includes(message.severity) ? "bad" : message.severity === "WARNING" ? "warn" : "";
    const row = element("li", undefined, kind);
    row.append(element("time", `${message.t_s.toFixed(1)} s`), message.text);
    list.prepend(row);
  }
  while (list.children.length > 60) list.lastChild.remove();
  messages = newest;
}

// Every panel, for each frame that is shown: of the present, the past or a log.
function show(frame, scene) {
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
  const reached = pace.reached();
  $("pace").textContent = past || reached === null ? "" : `${fixed(reached, 1)} × reached`;
  put("alarms", frame.failsafes.length ? `Failsafe: ${frame.failsafes.map(plain).join(", ")}` : "");
  showState(frame);
  showBars(scene, frame);
  showSensors(frame);
  showMessages(frame);
  $("pause").textContent = frame.paused ? "Resume" : "Pause";
  const speed = $("speed");
  if (document.activeElement !== speed && frame.speed > 0) speed.value = String(frame.speed);
  const flow = frame.extra_current_ned_m_s;
  showAges();
  $("flowtext").textContent = flow ? `added flow: ${fixed(flow[0])} m/s north, ${fixed(flow[1])} m/s east` : "";
  timeline.show();
}

function showScene(scene) {
  document.title = `${scene.title || scene.vehicle}: ${log ? "log" : "live view"}`;
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
  $("hint").textContent = [can.obstacles ? "Drag an obstacle on the plan, or Tab to it: arrow keys, then Enter. The fence stays where it is." : "", ...can.missing].join(" ").trim();
  $("camerabox").hidden = scene.camera_px === null;
}

// The stream

function listen(anew = false) {
  const wanted = $("camerabox").open ? "events?pictures=1" : "events";
  if (!anew && source && source.url.endsWith(wanted)) return;
  if (source) source.close();
  opened = heard = seconds();
  link.opened();
  const stream = (source = new EventSource(wanted));
  const on = (name, work) => stream.addEventListener(name, (event) => {
    if (stream !== source) return;
    // After a sleep of page or machine what comes first is what lay in buffers: a new stream begins with the present.
    const slept = wall() - seen.wall_s > ASLEEP_S && heard > opened;
    seen.wall_s = wall();
    if (slept) { listen(true); showAges(); return; }
    heard = seconds();
    work(JSON.parse(event.data));
    soon();
  });
  stream.addEventListener("open", () => { if (stream === source) link.opened(); });
  on("hello", hello);
  on("scene", (scene) => {
    if (seen.other) { forget(); present.frame = null; look(null); }
    present.scene = scene; present.trail = scene.trail_ned_m;
    if (past) return;
    messages = 0; $("messages").replaceChildren();
    adopt();
    showScene(scene);
  });
  on("frame", (frame) => {
    if (!present.scene) return;
    if (present.frame && frame.t_s < present.frame.t_s) forget();
    present.frame = frame;
    trouble = "";
    seen.other = false;
    link.take(frame, seconds());
    pace.take(frame);
    history.add(frame, present.scene, present.trail);
    const nav = frame.estimate, last = present.trail[present.trail.length - 1];
    if (nav && (!last || Math.hypot(last[0] - nav.pos_ned_m[0], last[1] - nav.pos_ned_m[1], last[2] - nav.pos_ned_m[2]) > 0.01)) {
      present.trail = [...present.trail.slice(1 - TRAIL), nav.pos_ned_m];
    }
    if (past) { showAges(); timeline.show(); return; }
    adopt();
    show(frame, seen.scene);
  });
  on("flow", (flow) => { present.flow = { ...flow, arrived: seconds() }; history.addSlow(history.flows, flow); adopt(); });
  on("trouble", (told) => { trouble = told.text; $("link").textContent = trouble; });
  on("picture", (picture) => {
    const image = new Image(), arrived = seconds();
    image.onload = () => {
      if (stream !== source) return;
      Object.assign(present, { picture: { ...picture, arrived }, image });
      history.addSlow(history.pictures, { ...picture, image, arrived, jpeg: "" });
      adopt();
      soon();
    };
    image.src = `data:image/jpeg;base64,${picture.jpeg}`;
  });
  stream.onerror = showAges;
}

const wall = () => Date.now() / 1e3; // goes on while the machine sleeps

// What is shown is the present, unless somebody looks at the past.
function adopt() { if (!past) Object.assign(seen, present); }

// A moment that is not the present; parts that are left out stay. The drawings follow at once, the panels as often as
// they can be read: to lay them out anew for each frame of a drag takes longer than a frame.
const PANELS_S = 0.05;
let panelled = 0, later = 0;
function showMoment(moment) {
  const { scene } = seen;
  Object.assign(seen, moment);
  if (seen.scene !== scene) showScene(seen.scene);
  if (moment.frame && !later) later = setTimeout(showPanels, Math.max(0, 1e3 * (PANELS_S - seconds() + panelled)));
  timeline.show();
  showAges();
  soon();
}

function showPanels() {
  later = 0;
  panelled = seconds();
  show(seen.frame, seen.scene);
}

// Of another run: nothing of the one before is shown beside it.
function forget() {
  Object.assign(present, { trail: [], picture: null, image: null, flow: null });
  seen.moving = null;
  history.clear();
  if (past) { past = false; adopt(); showScene(seen.scene); }
  pace = new Pace();
  drag = null;
}

// Which process this is. A new one has another token, and perhaps another page.
function hello({ token: now, version: theirs }) {
  if (version && theirs !== version) { location.reload(); return; }
  if (now === token) return;
  token = now;
  seen.other = true; // until its first frame all that stands here is of the process before
  $("said").textContent = "";
  showAges();
}

// A stream that has ended, or says nothing any more, is asked for anew. Ages go on by themselves.
function tick() {
  if (log) return;
  const now = seconds(), gone = source.readyState === 2;
  if (now - Math.max(heard, opened) > (gone ? 1 : REOPEN_S)) listen(true);
  showAges();
}

function say(words) { put("said", words); $("said").className = ""; }

async function ask(table) {
  const said = $("said");
  try {
    const answer = await fetch("do", { method: "POST", headers: { "Content-Type": "application/json", "X-View-Token": token }, body: JSON.stringify(table) });
    const words = await answer.json();
    said.textContent = words.done || words.error;
    said.className = answer.ok ? "" : "bad";
    if (answer.status === 403) listen(true); // of another process: its stream says what it takes
  } catch {
    said.textContent = "the process does not answer";
    said.className = "bad";
  }
}

// What the person does

$("pause").addEventListener("click", () => ask({ do: present.frame && present.frame.paused ? "go" : "pause" }));
$("speed").addEventListener("change", (event) => { ask({ do: "speed", value: Number(event.target.value) }); event.target.blur(); });
$("reset").addEventListener("click", () => ask({ do: "reset" }));
$("call").addEventListener("click", () => seen.scene && ask({ do: "fault", fault: seen.scene.steerable.faults[Number($("fault").value)].fault }));
$("still").addEventListener("click", () => ask({ do: "current", north_m_s: 0, east_m_s: 0 }));
$("camerabox").addEventListener("toggle", () => {
  if (!log) listen();
  else { player.pictures = $("camerabox").open; if (player.log) player.picture(); }
});

function spot(event) {
  const box = event.target.getBoundingClientRect();
  return [event.clientX - box.left, event.clientY - box.top, box.width, box.height];
}

// The obstacle under a pointer or a finger.
function grasped(event) {
  const [x, y] = spot(event);
  if (past || !seen.view || !seen.frame || !seen.scene.steerable.obstacles) return undefined;
  const [north, east] = seen.view.back(x, y);
  return seen.frame.solids.find((solid) => Math.hypot(solid.center_m[0] - north, solid.center_m[1] - east) <= solid.radius_m + 8 / seen.view.scale);
}

function look(camera) { seen.camera = camera; $("follow").ariaPressed = String(Boolean(camera && camera.follow)); soon(); }

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
const space = new SpaceView({ canvas: $("space"), button: $("solid"), chart: $("chart"), words: $("spacesaid") }, meta("nothree"), { redraw: soon, fit, follow });

// As the arrow keys point: pixels to the right and down.
const ARROWS = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1] };
const PAN_PX = 60;
const KEYS = { "+": () => zoom(ZOOM_STEP), "=": () => zoom(ZOOM_STEP), "-": () => zoom(1 / ZOOM_STEP), 0: fit, f: follow, F: follow };

function onPlanKey(event) {
  if (event.ctrlKey || event.metaKey || event.altKey) return;
  const way = ARROWS[event.key], work = way ? () => pan(way.map((part) => -PAN_PX * part)) : KEYS[event.key];
  if (!work) return;
  event.preventDefault();
  work();
}
$("plan").addEventListener("keydown", onPlanKey);

// A handle for each obstacle that can be moved, for the keyboard; the pointer drags on the plan itself.
function showHandles(width, height) {
  const solids = !past && seen.frame && seen.scene.steerable.obstacles ? seen.frame.solids : [], box = $("handles");
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
  one.addEventListener("blur", () => { if (!drag) { seen.moving = null; soon(); } });
  one.addEventListener("keydown", (event) => onHandleKey(event, solid()));
  return one;
}

// Arrow keys carry an obstacle by tenths of the grid, Enter puts it down, Escape leaves it where it was.
function onHandleKey(event, { number, center_m, radius_m }) {
  const way = ARROWS[event.key], { view } = seen;
  if (way && !event.ctrlKey && !event.metaKey && !event.altKey) {
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
  zoom(Math.exp(-0.002 * event.deltaY * (event.deltaMode ? 20 : event.ctrlKey ? 5 : 1)), spot(event)); // ctrl: a touchpad's pinch
}, { passive: false });
$("plan").addEventListener("pointerdown", (event) => {
  if (event.button > 0) return;
  const hit = pointers.size ? undefined : grasped(event);
  pointers.set(event.pointerId, spot(event));
  if (hit) {
    seen.moving = { number: hit.number, place: hit.center_m, radius_m: hit.radius_m };
    drag = { number: hit.number };
  } else {
    if (drag) seen.moving = null;
    drag = { plan: true };
  }
  event.target.setPointerCapture(event.pointerId);
});
$("plan").addEventListener("pointermove", (event) => {
  if (!drag || !pointers.has(event.pointerId)) return;
  const before = pointers.get(event.pointerId), now = spot(event);
  pointers.set(event.pointerId, now);
  if (drag.number) {
    seen.moving = { ...seen.moving, place: seen.view.back(now[0], now[1]) };
    soon();
    return;
  }
  const other = [...pointers].find(([id]) => id !== event.pointerId);
  if (other) pinch(other[1], before, now);
  else if (event.pointerType !== "touch" || seen.camera) pan([now[0] - before[0], now[1] - before[1]]);
});

// One of two fingers moves: the plan is zoomed as their distance, and goes with the point between them.
function pinch([x, y], [x0, y0], [x1, y1]) {
  const apart = (px, py) => Math.max(Math.hypot(px - x, py - y), 1);
  zoom(apart(x1, y1) / apart(x0, y0), [(x + x0) / 2, (y + y0) / 2]);
  if (!seen.camera || seen.camera.follow) return;
  const canvas = $("plan");
  look(panned(planView(canvas.clientWidth, canvas.clientHeight, seen.view.all, seen.camera), [(x1 - x0) / 2, (y1 - y0) / 2]));
}

$("plan").addEventListener("pointerup", (event) => {
  pointers.delete(event.pointerId);
  const number = drag && drag.number;
  if (!pointers.size) drag = null;
  if (!number) return;
  seen.moving = drag = null;
  const [x, y] = spot(event), [north_m, east_m] = seen.view.back(x, y);
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
for (const name of ["plan", "flow"]) $(name).addEventListener("pointercancel", () => { pointers.clear(); drag = seen.moving = null; soon(); });

// Arrow keys turn and lengthen the arrow of the added flow, as the plan lies; Enter adds it, Escape does not.
const FLOW_STEP_M_S = 0.05;
$("flow").addEventListener("keydown", (event) => {
  const way = ARROWS[event.key], flow = (drag && drag.flow) || (seen.frame && seen.frame.extra_current_ned_m_s);
  if (!flow || event.ctrlKey || event.metaKey || event.altKey) return;
  if (way) {
    const [dn, de] = seen.view && seen.view.turned ? way : [-way[1], way[0]];
    const part = (value, step) => Math.max(-1, Math.min(1, Math.round(100 * (value + FLOW_STEP_M_S * step)) / 100));
    drag = { flow: [part(flow[0], dn), part(flow[1], de)] };
    say(`Flow ${fixed(drag.flow[0])} m/s north, ${fixed(drag.flow[1])} m/s east: Enter adds it, Escape does not`);
  } else if (event.key === "Enter" && drag && drag.flow) {
    const [north_m_s, east_m_s] = drag.flow;
    drag = null;
    ask({ do: "current", north_m_s, east_m_s });
  } else if (event.key === "Escape" && drag && drag.flow) {
    drag = null;
    say("");
  } else return;
  event.preventDefault();
  soon();
});
$("flow").addEventListener("blur", () => { if (drag && drag.flow) { drag = null; soon(); } });
window.addEventListener("resize", soon);
dark.addEventListener("change", () => { legend(); for (const id in DIALS) $(id).ariaLabel = ""; soon(); });
setInterval(tick, 250);
document.addEventListener("visibilitychange", showAges);

// Items of a list: words, and the colour and kind of the mark before them.
function keyed(rows) {
  return rows.map(([words, name, kind]) => {
    const item = element("li");
    if (kind) {
      const mark = element("i", undefined, kind);
      mark.style.color = colors()[name];
      item.append(mark);
    }
    item.append(words);
    return item;
  });
}

// The last item of the legend is a switch.
function legend() { $("legend").replaceChildren(...keyed(LEGEND), $("switch")); }

$("distances").addEventListener("click", () => {
  seen.margins = !seen.margins;
  $("distances").ariaPressed = String(seen.margins);
  soon();
});

// The past of the live view

const recent = {
  get begin() { return history.begin; },
  get end() { return history.end; },
  at: 0,
  get now() { return past ? recent.at : history.end; },
  get live() { return !past; },
  playing: false,
  get events() { return history.messages; },
  history: () => history,
  to: 0,
  window: (span_s) => (past ? [recent.to - span_s, recent.to] : [history.end - span_s, history.end]), // stands still in the past
  spanned: () => { if (past) recent.seek(recent.now); soon(); },
  seek(t_s) {
    const moment = history.moment(t_s), span_s = timeline.span, { t_s: t } = moment ? moment.frame : {};
    if (!moment) return;
    if (!past) recent.to = history.end;
    if (t < recent.to - span_s || t > recent.to) recent.to = Math.min(t + span_s / 2, history.end);
    past = true;
    recent.at = Math.max(t_s, history.begin);
    showMoment(moment);
  },
  toEnd() {
    if (!past) return;
    past = false;
    showMoment(present);
  },
};

// A log

const player = new Player(showMoment, (text) => { trouble = text; put("link", text); }, soon);
const played = {
  get begin() { return player.log ? player.log.begin_s : 0; },
  get end() { return player.log ? player.log.end_s : 0; },
  get now() { return player.t; },
  live: false,
  get playing() { return player.playing; },
  get events() { return player.log ? player.log.events : []; },
  history: () => player.charts,
  window: () => player.window,
  spanned: (span_s) => player.chart(span_s),
  seek(t_s) { player.seek(t_s); timeline.show(); soon(); address(); },
  toEnd() {},
  play(on) { player.play(on); timeline.show(); address(); },
  rate(times) { player.rate = times; },
};

const ADDRESS_S = 1; // between two times in the address, which browsers bound
let addressed = 0, pending = 0;
function address() {
  const wait = ADDRESS_S - (seconds() - addressed);
  if (pending || !player.log) return;
  pending = setTimeout(() => {
    pending = 0;
    addressed = seconds();
    window.history.replaceState(null, "", `#t=${player.t.toFixed(1)}`);
  }, Math.max(0, 1e3 * wait));
}

async function playLog() {
  try {
    const { scene, begin_s } = await player.open();
    seen.scene = scene;
    showScene(scene);
    player.pictures = $("camerabox").open && scene.camera_px !== null;
    player.seek(timeOfAddress(location) ?? begin_s);
    player.chart(timeline.span);
  } catch (error) { player.failed(error); }
  window.addEventListener("hashchange", ({ newURL }) => { const t_s = timeOfAddress(new URL(newURL)); if (t_s !== null && Math.abs(t_s - player.t) > 0.06) played.seek(t_s); });
  let before = seconds();
  const step = () => {
    const now = seconds();
    if (player.playing) {
      player.tick(Math.min(now - before, 0.25));
      timeline.show();
      soon();
      address();
    }
    before = now;
    requestAnimationFrame(step);
  };
  requestAnimationFrame(step);
}

const timeline = new Timeline(log ? played : recent, log);

// What there is room for: a picture on a desk, the plan first on a phone.
if (matchMedia("(min-width: 801px)").matches) $("camerabox").open = true;
else $("steer").open = false;
legend();
if (log) playLog();
else listen();
