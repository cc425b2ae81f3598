// Panels: words, bars and tables of a frame, how old they are, and what the scene offers.
import { ageText, pictureAge } from "./ages.js";
import { attitudeOf, attitudeWords, drawCompass, drawHorizon } from "./attitude.js";
import { LEGEND } from "./draw.js";
import { $, ages, colors, context, current, degrees, element, fixed, link, log, lost, pace, plain, put, seconds, seen, set, soon } from "./page.js";

const PAST_PICTURE_S = 1; // between two pictures that are kept
let messages = 0; // number of the newest that is listed

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
export function show(frame, scene) {
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
  $("pace").textContent = seen.past || reached === null ? "" : `${fixed(reached, 1)} × reached`;
  put("alarms", frame.failsafes.length ? `Failsafe: ${frame.failsafes.map(plain).join(", ")}` : "");
  showState(frame);
  showBars(scene, frame);
  showSensors(frame);
  showMessages(frame);
  $("pause").textContent = frame.paused ? "Resume" : "Pause";
  const speed = $("speed");
  if (document.activeElement !== speed && frame.speed > 0) speed.value = String(frame.speed);
  const flow = frame.extra_current_ned_m_s;
  $("flowtext").textContent = flow ? `added flow: ${fixed(flow[0])} m/s north, ${fixed(flow[1])} m/s east` : "";
  showAges();
}

export function showScene(scene) {
  messages = 0;
  $("messages").replaceChildren();
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

// Ages

// How old the picture is that is shown, in words; "" while it is of now.
export function pictureOld(now) {
  const { picture, frame } = seen;
  if (!picture || !frame) return "";
  if (seen.past) return frame.t_s - picture.t_s > ages().picture_s + PAST_PICTURE_S ? ageText(frame.t_s - picture.t_s) : "";
  if (link.age(now) === null) return "";
  const { age, old } = pictureAge(picture, frame, now), behind = link.age(now);
  return seen.other || behind > ages().link_s || old(ages().picture_s) ? ageText(age + behind) : "";
}

// An age beside what it belongs to, which is grey when it is old.
function mark(id, words, old, ...parts) {
  put(id, words);
  set($(id), "className", old ? "age old" : "age");
  for (const part of parts) $(part).classList.toggle("stale", Boolean(old));
}

// Everything that is shown, as old as it is now.
export function showAges() {
  const { scene, frame, picture } = seen, now = seconds(), late = link.age(now), behind = seen.past ? 0 : late;
  if (!scene || !frame || behind === null) return;
  const limits = scene.ages, cut = !log && (seen.other || late > limits.link_s), dead = cut && !seen.past, nav = frame.estimate;
  const told = (age, old) => (old ? `${ageText(age)} old` : ageText(age)), frames = seen.past ? "" : told(behind, dead);
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
  put("link", !cut ? seen.trouble
    : link.stream.readyState !== 1 ? `no connection to the vehicle's process; all this is ${ageText(late)} old`
    : silence > limits.link_s ? `no news from the vehicle's process for ${ageText(silence)}`
    : link.loop > limits.link_s ? `the loop has been silent for ${ageText(link.loop)}`
    : `the connection is slow: all this is ${ageText(late)} old`);
  if (old || seen.pictureOld) soon();
  seen.pictureOld = Boolean(old);
}

// Attitude and legend

const DIALS = { horizon: [drawHorizon, "Artificial horizon, roll positive with the right side down, pitch with the nose up"], compass: [drawCompass, "Compass, north up"] };
export function showAttitude(frame, palette) {
  const facts = attitudeOf(frame), words = attitudeWords(facts);
  for (const [id, [drawn, name]] of Object.entries(DIALS)) {
    drawn(...context($(id)), facts, palette);
    const told = `${name}: ${words[id].map(([line]) => line).join("; ")}`;
    if ($(id).ariaLabel === told) continue;
    $(id).ariaLabel = told;
    $(`${id}key`).replaceChildren(...keyed(words[id]));
  }
}

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

// In the colours of the theme. The last item of the legend is a switch.
export function showColors() {
  $("legend").replaceChildren(...keyed(LEGEND), $("switch"));
  for (const id in DIALS) $(id).ariaLabel = "";
  soon();
}
