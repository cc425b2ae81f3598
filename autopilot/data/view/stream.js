// The process: its stream, which becomes the present and the history, and what is asked of it.
import { ASLEEP_S, REOPEN_S } from "./ages.js";
import { History } from "./history.js";
import { $, link, look, meta, pace, present, put, seconds, seen, soon } from "./page.js";
import { show, showAges, showScene } from "./panels.js";

export const history = new History();
const version = meta("version");
let token = meta("token"), source = null, opened = 0, heard = 0, woken = 0;

export function listen(anew = false) {
  const wanted = $("camerabox").open ? "events?pictures=1" : "events";
  if (!anew && source && source.url.endsWith(wanted)) return;
  if (source) source.close();
  opened = heard = seconds();
  link.opened();
  const stream = (source = link.stream = new EventSource(wanted));
  const on = (name, work) => stream.addEventListener(name, (event) => {
    if (stream !== source) return;
    // After a sleep of page or machine what comes first is what lay in buffers: a new stream begins with the present.
    const slept = wall() - woken > ASLEEP_S && heard > opened;
    woken = wall();
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
    if (seen.past) return;
    adopt();
    showScene(scene);
  });
  on("frame", (frame) => {
    if (!present.scene) return;
    if (present.frame && frame.t_s < present.frame.t_s) forget();
    present.frame = frame;
    seen.trouble = "";
    seen.other = false;
    link.take(frame, seconds());
    pace.take(frame);
    history.add(frame, present.scene, present.trail);
    present.trail = history.trail(frame.t_s);
    if (seen.past) { showAges(); return; }
    adopt();
    show(frame, seen.scene);
  });
  on("flow", (flow) => { present.flow = { ...flow, arrived: seconds() }; history.addSlow(history.flows, flow); adopt(); });
  on("trouble", (told) => { seen.trouble = told.text; put("link", told.text); });
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
function adopt() { if (!seen.past) Object.assign(seen, present); }

// Of another run: nothing of the one before is shown beside it.
function forget() {
  Object.assign(present, { trail: [], picture: null, image: null, flow: null });
  seen.moving = seen.drag = null;
  history.clear();
  if (seen.past) { seen.past = false; adopt(); showScene(seen.scene); }
  pace.clear();
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
export function tick() {
  const now = seconds(), gone = source.readyState === 2;
  if (now - Math.max(heard, opened) > (gone ? 1 : REOPEN_S)) listen(true);
  showAges();
}

export function say(words) { put("said", words); $("said").className = ""; }

export async function ask(table) {
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

