// The one stream of events: the newest picture of every machine, and for how long there has been none.
import { language, parse, start } from "./dom.js";

const CUT_S = 3; // pictures come once a second at least
const LATE_S = 2;
const QUIET_MS = 900; // a picture a second has told already

export const state = { order: [], machines: Object.create(null), arrived: null };
let source = null, told = () => {}, offset = null, retry = 0;

// A picture that waited on its way (a computer that slept, a network that stood still) is as old as it is: against the
// quickest one of this connection it is late by so many seconds.
function lateness(taken) {
  const now = Date.now() / 1000 - taken;
  if (offset === null || now < offset) offset = now;
  return now - offset;
}

export function take(picture) {
  const now = performance.now();
  for (const [name, machine] of Object.entries(picture.machines)) {
    state.machines[name] = { ...machine, arrived: now - 1000 * lateness(machine.taken) };
  }
  state.order = picture.order;
  for (const name of Object.keys(state.machines)) if (!state.order.includes(name)) delete state.machines[name];
  const arrivals = state.order.map((name) => state.machines[name]?.arrived ?? -Infinity);
  state.arrived = arrivals.length ? Math.max(...arrivals) : now;
}

// Seconds since the newest picture, or since a machine's; null before the first.
export function age(name = null) {
  const arrived = name === null ? state.arrived : state.machines[name]?.arrived;
  return arrived === null || arrived === undefined ? null : (performance.now() - arrived) / 1000;
}
export const isCut = (name = null) => {
  const seconds = age(name);
  return seconds === null || seconds > CUT_S;
};

function connect() {
  source?.close();
  offset = null;
  source = new EventSource(`/api/live?lang=${language}`);
  source.onmessage = (event) => {
    const picture = parse(event.data);
    take(picture);
    retry = 0;
    // One that stays late, though it is the newest there is: a clock was set. The next connection measures anew.
    if (age() > LATE_S + 1 && Date.now() - opened > 10000) connect();
    told();
  };
  source.onerror = () => {
    told();
    if (source.readyState === EventSource.CLOSED) setTimeout(connect, Math.min(1000 * 2 ** retry++, 10000));
  };
  opened = Date.now();
}
let opened = 0;

// Follow; `changed` is called at every picture, and once a second where none comes, since ages grow.
export function follow(changed) {
  told = changed;
  if (start.state) take(start.state);
  if (start.may_read) connect();
  setInterval(() => (age() ?? 1) * 1000 >= QUIET_MS && told(), 1000);
  document.addEventListener("visibilitychange", () => told());
}
