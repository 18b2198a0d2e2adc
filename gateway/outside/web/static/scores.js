// Scores from the records, asked once in a while: they read all that is kept.
import { ask } from "./dom.js";

const AGAIN_MS = 600000;
const kept = new Map();

// The scorecards of a temperature, {weeks} or {error}; {} while it is under way. `changed` is called when it is there.
export function scoreOf(machine, temperature, changed = () => {}) {
  const key = `${machine} ${temperature}`, known = kept.get(key);
  if (!known || performance.now() - known.asked > AGAIN_MS) {
    const row = { ...(known || {}), asked: performance.now() };
    kept.set(key, row);
    ask("GET", "/api/scorecard", { machine, temperature })
      .then(({ weeks }) => Object.assign(row, { weeks, error: undefined }))
      .catch((error) => Object.assign(row, { error: error.message }))
      .finally(changed);
  }
  return kept.get(key);
}
