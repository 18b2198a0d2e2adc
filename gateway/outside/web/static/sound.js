// A sound for what has to be dealt with, where somebody asked this browser for it: no page may begin to sound by itself.
import { state } from "./live.js";

const AGAIN_S = 10, TONES_HZ = [880, 660], TONE_S = 0.18;
let context = null, told = -Infinity, known = new Set();

export const sounds = () => context !== null;

export function switchSound() {
  if (context) context.close();
  context = context ? null : new AudioContext();
  told = -Infinity;
}

// Alarms of priority 1 that nobody has acknowledged sound when one comes, and again until somebody has.
export function soundAlarms() {
  const waiting = state.order.flatMap((name) => state.machines[name].alarms
    .filter((alarm) => alarm.priority === 1 && alarm.state === "unacknowledged").map((alarm) => `${name} ${alarm.name} ${alarm.since}`));
  const fresh = waiting.some((each) => !known.has(each));
  known = new Set(waiting);
  if (!context || !waiting.length || (!fresh && performance.now() / 1000 - told < AGAIN_S)) return;
  told = performance.now() / 1000;
  TONES_HZ.forEach((frequency, place) => {
    const tone = new OscillatorNode(context, { frequency }), begin = context.currentTime + place * TONE_S;
    tone.connect(context.destination);
    tone.start(begin);
    tone.stop(begin + TONE_S);
  });
}
