// The page: draws what is seen, and goes to moments of the past or of a log.
import { ageText, pictureAge } from "./ages.js";
import { drawFlow, drawPicture, drawPlan, drawSide } from "./draw.js";
import { $, ages, calm, colors, context, current, dark, drawWith, log, lost, present, put, seconds, seen, soon } from "./page.js";
import { pictureOld, show, showAges, showAttitude, showColors, showScene } from "./panels.js";
import { extent, followed, planView } from "./plan.js";
import { Player, timeOfAddress } from "./player.js";
import { showHandles, space } from "./steering.js";
import { history, listen, tick } from "./stream.js";
import { Timeline } from "./timeline.js";

function draw() {
  const palette = colors();
  if (seen.scene) {
    const { frame, flow } = seen, now = seconds();
    const shown = { ...seen, frame: frame && { ...frame, control: current(frame) }, lost: frame && lost(frame) };
    const water = !seen.past && flow && frame && pictureAge(flow, frame, now);
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
    timeline.draw(...context($("strips")), seen, palette);
  }
  if (!later) drawPanels(palette);
  if ($("camerabox").open && !$("camerabox").hidden) drawPicture(...context($("camera")), seen.picture, seen.image, pictureOld(seconds()), palette);
}

function drawPanels(palette) {
  const { scene, frame, drag } = seen;
  if (frame && $("attitude").open) showAttitude({ ...frame, control: current(frame) }, palette);
  if (scene && scene.steerable.current) drawFlow(...context($("flow")), drag && drag.flow ? drag.flow : frame && frame.extra_current_ned_m_s, seen.view && seen.view.turned, palette);
  timeline.show();
}

// A moment that is not the present; parts that are left out stay. Plan, side view and charts follow at once, the panels as
// often as they can be read: to lay them out anew for each frame of a drag takes longer than a frame.
const PANELS_S = 0.1; // as live
let panelled = 0, later = 0;
function showMoment(moment) {
  const { scene } = seen;
  Object.assign(seen, moment);
  if (seen.scene !== scene) showScene(seen.scene);
  if (!moment.frame) showAges();
  else if (!later) later = setTimeout(showPanels, Math.max(0, 1e3 * (PANELS_S - seconds() + panelled)));
  soon();
}

function showPanels() {
  later = 0;
  panelled = seconds();
  show(seen.frame, seen.scene);
  drawPanels(colors());
}

// The past of the live view

const recent = {
  get begin() { return history.begin; },
  get end() { return history.end; },
  at: 0,
  get now() { return seen.past ? recent.at : history.end; },
  get live() { return !seen.past; },
  playing: false,
  get events() { return history.messages; },
  history: () => history,
  to: 0,
  window: (span_s) => (seen.past ? [recent.to - span_s, recent.to] : [history.end - span_s, history.end]), // stands still in the past
  spanned: () => { if (seen.past) recent.seek(recent.now); soon(); },
  seek(t_s) {
    const moment = history.moment(t_s), span_s = timeline.span, { t_s: t } = moment ? moment.frame : {};
    if (!moment) return;
    if (!seen.past) recent.to = history.end;
    if (t < recent.to - span_s || t > recent.to) recent.to = Math.min(t + span_s / 2, history.end);
    seen.past = true;
    recent.at = Math.max(t_s, history.begin);
    showMoment(moment);
  },
  toEnd() {
    if (!seen.past) return;
    seen.past = false;
    showMoment(present);
  },
};

// A log

const player = new Player(showMoment, (text) => { seen.trouble = text; put("link", text); }, soon);
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
  seek(t_s) { player.seek(t_s); soon(); address(); },
  toEnd() {},
  play(on) { player.play(on); soon(); address(); },
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
      soon();
      address();
    }
    before = now;
    requestAnimationFrame(step);
  };
  requestAnimationFrame(step);
}

const timeline = new Timeline(log ? played : recent, log);

drawWith(draw);
$("camerabox").addEventListener("toggle", () => {
  if (!log) listen();
  else { player.pictures = $("camerabox").open; if (player.log) player.rest(); }
});
$("distances").addEventListener("click", () => {
  seen.margins = !seen.margins;
  $("distances").ariaPressed = String(seen.margins);
  soon();
});
window.addEventListener("resize", soon);
dark.addEventListener("change", showColors);
document.addEventListener("visibilitychange", showAges);
// What there is room for: a picture on a desk, the plan first on a phone.
if (matchMedia("(min-width: 801px)").matches) $("camerabox").open = true;
else $("steer").open = false;
showColors();
if (log) playLog();
else {
  listen();
  setInterval(tick, 250);
}
