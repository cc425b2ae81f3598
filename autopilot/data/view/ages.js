// How old what is shown is. Nothing here knows the page.
// A datum's age is that in the vehicle's time when its frame was made (the process says it), and the real time since:
// what the loop has been silent for, what the frame was delayed by on its way, and since then. Limits: scene.ages.

export const ASLEEP_S = 4; // of silence on an open stream: what comes first after it may have lain in a buffer
const PACE_S = 3; // over which the speed of a simulation is taken
export const REOPEN_S = 8; // of silence: the stream is as good as gone

// What the stream says about itself. Times in s, `now` on the page's monotonic clock, `sent` on the process's.
export class Link {
  constructor() { this.arrived = null; this.delay = 0; this.loop = 0; this.opened(); }
  // A new stream: how the two clocks differ is not known until its first frame, which has waited for nothing.
  opened() { this.offset = Infinity; }
  take(frame, now) {
    this.offset = Math.min(this.offset, now - frame.sent_s);
    this.delay = now - frame.sent_s - this.offset;
    this.arrived = now;
    this.loop = frame.paused ? 0 : frame.stale_s; // while time stands still nothing grows old
  }
  // Of the newest frame; null before the first.
  age(now) { return this.arrived === null ? null : this.delay + this.loop + now - this.arrived; }
  since(now) { return this.arrived === null ? Infinity : now - this.arrived; }
}

// How fast the vehicle's time has gone lately in real time, null while that is not known.
export class Pace {
  constructor() { this.clear(); }
  clear() { this.frames = []; }
  take(frame) {
    const last = this.frames[this.frames.length - 1];
    if (frame.paused || (last && (frame.t_s < last.t_s || frame.speed !== last.speed))) this.frames = [];
    if (!frame.paused) this.frames.push({ t_s: frame.t_s, sent_s: frame.sent_s - frame.stale_s, speed: frame.speed });
    while (this.frames.length > 2 && frame.sent_s - this.frames[1].sent_s > PACE_S) this.frames.shift();
  }
  reached() {
    const [first, last] = [this.frames[0], this.frames[this.frames.length - 1]];
    return first && last.sent_s - first.sent_s > 0.5 * PACE_S ? (last.t_s - first.t_s) / (last.sent_s - first.sent_s) : null;
  }
}

// A picture comes less often in the vehicle's time the faster that goes: old is what is old by both clocks.
export function pictureAge(picture, frame, now) {
  const vehicle = Math.max(0, frame.t_s - picture.t_s);
  return { age: vehicle, old: (limit) => vehicle > limit && now - picture.arrived > limit };
}

export function ageText(seconds) {
  if (seconds < 9.95) return `${seconds.toFixed(1)} s`;
  if (seconds < 119.5) return `${seconds.toFixed(0)} s`;
  return seconds < 7170 ? `${(seconds / 60).toFixed(0)} min` : `${(seconds / 3600).toFixed(0)} h`;
}
