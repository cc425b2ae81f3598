// Plays a log: asks the process for frames of it, and keeps those around the time that is shown.
import { History, messagesUpTo } from "./history.js";

const STEP_S = 0.1, BLOCK = 50, KEPT_BLOCKS = 24; // frames of a block
const CHART_FRAMES = 600, PART = 100; // of the charts, and of these in one request
const FLOW_STEP_S = 1;
const FAST = 4; // from that speed on every fourth frame is enough
export const RATES = [0.25, 0.5, 1, 2, 4, 8, 16];

async function asked(path) {
  const answer = await fetch(path), made = await answer.json();
  if (!answer.ok) throw new Error(made.error);
  return made;
}

export class Player {
  // `show` takes a moment, `say` what goes wrong, `drawn` that there is more of the charts.
  constructor(show, say, drawn) {
    Object.assign(this, { show, say, drawn, log: null, t: 0, playing: false, rate: 1, pictures: false });
    Object.assign(this, { blocks: new Map(), charts: new History(false), window: [0, 0], turn: 0, asking: false, again: false, beside: {} });
  }

  async open() {
    this.log = await asked("log");
    this.window = [this.log.begin_s, this.log.end_s];
    return this.log;
  }

  seek(t_s) {
    this.t = Math.min(Math.max(t_s, this.log.begin_s), this.log.end_s);
    this.present();
    this.follow();
  }

  play(on) {
    if (on && this.t >= this.log.end_s) this.t = this.log.begin_s;
    this.playing = on;
  }

  // Real time has gone on.
  tick(dt) {
    if (!this.playing) return;
    const step = this.step(), next = Math.min(this.t + dt * this.rate, this.log.end_s);
    this.block(next + BLOCK * step, step);
    if (!this.block(next, step)) return; // it waits for the process
    this.t = next;
    if (next >= this.log.end_s) this.playing = false;
    this.present();
    this.follow();
  }

  // Charts of the time that is shown.
  follow() { if (this.t < this.window[0] || this.t > this.window[1]) this.chart(this.span_s); }

  step() { return this.rate > FAST ? 4 * STEP_S : STEP_S; }

  // The block of frames that has this time; asked for if it is not there yet.
  block(t_s, step) {
    if (t_s > this.log.end_s + BLOCK * step) return null;
    const number = Math.floor((t_s - this.log.begin_s) / (BLOCK * step) + 1e-9), key = `${step} ${number}`, kept = this.blocks.get(key);
    if (kept) {
      this.blocks.delete(key);
      this.blocks.set(key, kept); // the last that is dropped
      return kept.frames ? kept : null;
    }
    const from = this.log.begin_s + number * BLOCK * step, made = { from, step, frames: null, trail: [] };
    if (from > this.log.end_s) return null;
    this.blocks.set(key, made);
    if (this.blocks.size > KEPT_BLOCKS) this.blocks.delete(this.blocks.keys().next().value);
    asked(`frames?from=${from}&to=${from + (BLOCK - 1) * step}&step=${step}`).then((answer) => {
      Object.assign(made, { frames: answer.frames, trail: answer.trail_ned_m });
    }, (error) => { this.blocks.delete(key); this.failed(error); });
    return null;
  }

  // Show the time that is wanted: from what is there, and by asking for that frame alone.
  present() {
    const block = [this.step(), STEP_S].map((step) => this.blocks.get(`${step} ${Math.floor((this.t - this.log.begin_s) / (BLOCK * step) + 1e-9)}`)).find((one) => one && one.frames);
    if (block) {
      const index = Math.min(Math.floor((this.t - block.from) / block.step + 1e-6), block.frames.length - 1);
      this.give(block.frames[index], [...block.trail, ...block.frames.slice(0, index + 1).flatMap(({ estimate }) => (estimate ? [estimate.pos_ned_m] : []))]);
    }
    if (!this.playing) this.single(); // to the tick, where time stands still
    this.rest();
  }

  async single() {
    if (this.asking) { this.again = true; return; }
    this.asking = true;
    const t = this.t;
    try {
      const { frames: [frame], trail_ned_m: trail } = await asked(`frames?from=${t}&to=${t}&step=1`);
      if (!this.playing) this.give(frame, frame.estimate ? [...trail, frame.estimate.pos_ned_m] : trail);
    } catch (error) { this.failed(error); }
    this.asking = false;
    if (this.again) { this.again = false; this.present(); }
  }

  give(frame, trail) {
    this.say("");
    this.show({ frame: { ...frame, messages: messagesUpTo(this.log.events, frame.t_s) }, trail, scene: this.log.scene });
  }

  // What is asked for by itself: the camera's picture, and of a simulation the field of the current.
  rest() {
    if (this.log.scene.simulated) this.ask("flow", FLOW_STEP_S, (flow) => ({ flow }));
    if (this.pictures) this.ask("picture", STEP_S, async (picture) => {
      const image = picture && new Image();
      if (image) {
        image.src = `data:image/jpeg;base64,${picture.jpeg}`;
        await image.decode();
      }
      return { picture: picture && { ...picture, arrived: performance.now() / 1e3 }, image };
    });
  }

  // One request of a kind at a time.
  async ask(kind, step_s, made) {
    const t = Math.floor(this.t / step_s) * step_s, before = (this.beside[kind] ??= { asking: false, t: NaN });
    if (before.asking || t === before.t) return;
    Object.assign(before, { asking: true, t });
    try { this.show(await made(await asked(`${kind}?t=${t}`))); } catch (error) { this.failed(error); }
    before.asking = false;
    this.ask(kind, step_s, made);
  }

  failed(error) { this.playing = false; this.say(`${error.message ?? error}`); }

  // Charts of so many seconds round the time that is shown; 0 = of the whole log.
  async chart(span_s) {
    this.span_s = span_s;
    const { begin_s, end_s } = this.log, whole = !span_s || span_s >= end_s - begin_s;
    const from = whole ? begin_s : Math.min(Math.max(this.t - span_s / 2, begin_s), end_s - span_s), to = whole ? end_s : from + span_s;
    const step = Math.max(STEP_S, (to - from) / CHART_FRAMES), turn = (this.turn += 1);
    this.window = [from, to];
    this.charts = new History(false);
    try {
      for (let k = 0; from + k * step <= to; k += PART) {
        const last = Math.min(from + (k + PART - 1) * step, to), { frames } = await asked(`frames?from=${from + k * step}&to=${last}&step=${step}`);
        if (turn !== this.turn) return;
        for (const frame of frames) this.charts.add(frame, this.log.scene);
        this.drawn();
      }
    } catch (error) { this.failed(error); }
  }
}

// A time in the address: #t=12.3 or ?t=12.3, null without one.
export function timeOfAddress({ hash, search }) {
  const given = new URLSearchParams(hash.replace(/^#/, "")).get("t") ?? new URLSearchParams(search).get("t");
  const t_s = given === null || given === "" ? NaN : Number(given);
  return Number.isFinite(t_s) ? t_s : null;
}
